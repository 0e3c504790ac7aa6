"""Adaptive samples: more where noise is, as many as asked for, and the right mean."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy
from gpf.rendering.adaptive import (
    MAX_RATIO,
    allocate,
    pixel_noise,
    sample_adaptively,
)
from gpf.rendering.sample_sets import tile_order

SIZE = WIDTH, HEIGHT = 24, 16


def noise_of(mean: np.ndarray, square: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The noise of each pixel, (H, W), from arrays of numpy."""
    channels = [from_numpy(mi.Float64, channel) for channel in mean.T]
    noise = pixel_noise(channels, from_numpy(mi.Float64, square), size)
    return noise.numpy().reshape(size[::-1])


@pytest.mark.parametrize("kind", ["independent", "multijitter"])
def test_the_mean_has_no_bias(kind):
    """Rare bright samples in one half of the image: its expected value is 1, as in the other."""
    chance = 0.05

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        rare = dr.select(sampler.next_1d() < chance, mi.Float(1 / chance), 0)
        value = dr.select(pixel.x < WIDTH // 2, rare, 1)
        return [value, 2 * value, 3 * value, mi.Float(pixel.x), mi.Float(pixel.y)]

    sampler = mi.load_dict({"type": kind})
    runs = [
        np.array(sample_adaptively(sample, sampler, SIZE, 64, seed), np.float64)
        for seed in range(24)
    ]
    image = np.mean(runs, axis=0)
    y, x = np.indices((HEIGHT, WIDTH))
    np.testing.assert_allclose(image[..., 3], x)
    np.testing.assert_allclose(image[..., 4], y)
    np.testing.assert_allclose(
        image[:, WIDTH // 2 :, :3], np.ones((16, 12, 3)) * [1, 2, 3], rtol=1e-6
    )
    means = [run[:, : WIDTH // 2, 0].mean() for run in runs]
    error = np.std(means, ddof=1) / np.sqrt(len(means))
    assert error < 0.02
    assert np.mean(means) == pytest.approx(1, abs=4 * error)


def test_noise_falls_where_it_is():
    """A fifth of the image is noisy: with the same samples it has half the variance, or less."""
    spp, lanes = 64, []

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        lanes.append(dr.width(pixel))
        noise = dr.select(pixel.x < 5, 2 * sampler.next_1d(), 1)
        return [noise, noise, noise]

    sampler = mi.load_dict({"type": "independent"})
    image = np.array(sample_adaptively(sample, sampler, SIZE, spp, 3))
    assert 0.6 * spp < sum(lanes) / (WIDTH * HEIGHT) <= spp
    plain = (4 / 12) / spp
    assert np.var(image[:, :5, 0]) < 0.5 * plain
    np.testing.assert_array_equal(image[:, 5:], np.ones((HEIGHT, WIDTH - 5, 3)))


def test_the_variance_is_that_of_many_images():
    """Noise in the left half, more of it downwards; the sampler spreads samples evenly, too."""

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        strength = mi.Float(pixel.y + 4) / HEIGHT
        noise = dr.select(pixel.x < WIDTH // 2, strength * sampler.next_1d(), 1)
        return [noise, 2 * noise, 3 * noise]

    for kind in ("independent", "multijitter"):
        sampler = mi.load_dict({"type": kind})
        runs = np.stack(
            [
                np.array(sample_adaptively(sample, sampler, SIZE, 64, s, False, True))
                for s in range(40)
            ]
        )
        measured = runs[..., :3].var(axis=0, ddof=1).mean(axis=-1)
        told = runs[..., 3].mean(axis=0)
        for rows in (slice(0, 6), slice(10, 16)):
            inner = rows, slice(0, WIDTH // 2 - 2)
            assert told[inner].mean() == pytest.approx(measured[inner].mean(), rel=0.2)
        assert told[:, WIDTH // 2 + 2 :].max() < 1e-12


@pytest.mark.parametrize("kind", ["independent", "stratified", "multijitter", "ldsampler"])
def test_the_variance_is_known_where_no_pixel_needs_more_samples(kind):
    """From left to right: rare bright samples, which get all further ones; a little noise; none;
    and the edge of a lamp, whose noise is not that of what lies beside it."""
    size, edge = (64, 16), 56

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        one, other = sampler.next_2d()
        rare = dr.select((one < 0.3) & (other < 0.3), mi.Float(10), 0)
        little = dr.select(pixel.x < 40, 0.9 + 0.2 * other, 1)
        value = dr.select(pixel.x < 24, rare, little)
        value = dr.select((pixel.x == edge) & (one < 0.37), mi.Float(1000), value)
        return [value, 2 * value, 3 * value]

    sampler = mi.load_dict({"type": kind})
    runs = np.stack(
        [np.array(sample_adaptively(sample, sampler, size, 64, s, False, True)) for s in range(30)]
    )
    measured = runs[..., :3].var(axis=0, ddof=1).mean(axis=-1)
    told = runs[..., 3].mean(axis=0)
    little, none, beside = (np.s_[:, a:b] for a, b in ((28, 38), (44, 54), (edge + 1, edge + 3)))
    assert (told[little] > 0).all()  # also at the edge of the image
    assert told[little].mean() == pytest.approx(measured[little].mean(), rel=0.3)
    assert told[none].max() < 1e-12
    assert told[beside].max() < 0.001 * measured[:, edge].mean()


def test_the_same_seed_gives_the_same_bits():
    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        return [sampler.next_1d() for _ in range(3)]

    sampler = mi.load_dict({"type": "independent"})
    a, b, c = (np.array(sample_adaptively(sample, sampler, SIZE, 16, s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 0.01


@pytest.mark.parametrize("mean", [1, 3, 10])
def test_allocation_keeps_to_the_budget(mean):
    noise = np.random.default_rng(5).lognormal(0, 1.5, 5000)
    least = np.arange(5000) % 25 == 0
    sets = allocate(
        from_numpy(mi.Float64, noise), mean, from_numpy(mi.UInt32, least.astype(np.uint32))
    ).numpy()
    assert 0.95 * mean < sets.mean() <= mean
    assert (sets >= least).all() and sets.max() <= MAX_RATIO * mean
    noise, sets = noise[~least], sets[~least]
    assert (np.diff(sets[np.argsort(noise)]) >= 0).all()
    typical = (sets > 0) & (sets < MAX_RATIO * mean)
    ratio = sets[typical] / noise[typical]
    assert np.median(np.abs(ratio / np.median(ratio) - 1)) < 0.5


@pytest.mark.parametrize("noise", [0.0, 0.3, 1e30])
def test_equal_noise_is_treated_equally(noise):
    assert set(allocate(dr.full(mi.Float64, noise, 100), 3, mi.UInt32(0))) == {3}


def test_a_pixel_says_nothing_of_itself():
    mean, square = np.ones((15, 3)), np.ones(15)
    square[7] = 5  # in the middle of 5 × 3 pixels
    noise = noise_of(mean, square, (5, 3))
    assert noise[1, 2] < 1e-6  # no more than rounding
    assert noise[1, 1] > 0.1 and noise[0, 2] > 0.1


def test_what_is_far_brighter_than_the_rest_hardly_counts():
    """A display shows all of it as white."""
    mean = np.ones((200, 3))
    mean[160:] = 100
    noise = noise_of(mean, 1.01 * (mean**2).mean(axis=1), (10, 20))
    assert noise[-1].max() < 0.5 * noise[0].min()


@pytest.mark.parametrize(("width", "height"), [(8, 8), (7, 5), (1, 3), (25, 8), (33, 24)])
def test_tiles_go_through_every_pixel_once(width, height):
    order = tile_order(width, height).numpy()
    np.testing.assert_array_equal(np.sort(order), np.arange(width * height))
    first = order[: min(16, len(order))]
    if width >= 4 and height >= 4:
        assert set(first) == {y * width + x for y in range(4) for x in range(4)}


@pytest.mark.parametrize(
    "kind", ["independent", "stratified", "multijitter", "orthogonal", "ldsampler"]
)
@pytest.mark.parametrize("spp", [16, 35, 50, 64, 120, 256])
def test_any_sampler_and_number_of_samples(kind, spp):
    """At most as many as asked for, and hardly fewer."""
    lanes = []

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        lanes.append(dr.width(pixel))
        value = sampler.next_1d()
        return [value, value, mi.Float(1)]

    sampler = mi.load_dict({"type": kind})
    image = np.array(sample_adaptively(sample, sampler, SIZE, spp, 3))
    assert image[..., 0].mean() == pytest.approx(0.5, abs=0.02)
    np.testing.assert_allclose(image[..., 2], 1, rtol=1e-6)
    taken = sum(lanes) / (WIDTH * HEIGHT)
    assert taken <= spp
    assert taken > (0.5 if kind == "orthogonal" else 0.85) * spp  # squares of primes alone


def test_what_is_not_finite_stays_where_it_is():
    """It is for others to complain of; here it spoils neither its neighbours nor the run."""

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        bad = (pixel.x == 3) & (pixel.y == 5)
        value = dr.select(bad, dr.nan, sampler.next_1d())
        return [value, value, value]

    image = np.array(sample_adaptively(sample, mi.load_dict({"type": "independent"}), SIZE, 16, 3))
    assert np.isnan(image[5, 3]).all()
    assert np.isfinite(np.delete(image.reshape(-1, 3), 5 * WIDTH + 3, axis=0)).all()


def test_large_images_take_several_launches(monkeypatch):
    monkeypatch.setattr("gpf.rendering.sample_sets.largest_launch", lambda: 1000)
    widths = []

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        widths.append(dr.width(pixel))
        return [sampler.next_1d(), mi.Float(pixel.x), mi.Float(pixel.y)]

    image = np.array(sample_adaptively(sample, mi.load_dict({"type": "independent"}), SIZE, 64, 3))
    assert max(widths) <= 1000 and len(widths) > 20
    y, x = np.indices((HEIGHT, WIDTH))
    np.testing.assert_allclose(image[..., 1:], np.stack([x, y], axis=-1), rtol=1e-6)


def test_radiance_below_zero_is_no_obstacle():
    mean = np.full((60, 3), -0.01)
    mean[:30] = 1
    noise = noise_of(mean, 1.5 * (mean**2).mean(axis=1), (10, 6))
    assert np.isfinite(noise).all()
    assert allocate(from_numpy(mi.Float64, noise.ravel()), 3, mi.UInt32(0)).numpy().mean() <= 3
