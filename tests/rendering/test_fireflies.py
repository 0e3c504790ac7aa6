"""Fireflies: what no rival confirms counts less, and nothing else does."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy
from gpf.rendering.adaptive import sample_adaptively
from gpf.rendering.fireflies import RIVALS, TOLERANCE, BrightestBlocks, choose_block_size

SIZE = WIDTH, HEIGHT = 7, 5


def told(*launches: tuple[np.ndarray, np.ndarray]) -> BrightestBlocks:
    """Of blocks (N, B, 3) of pixels (N,) in groups, launch by launch."""
    brightest = BrightestBlocks(SIZE)
    for pixels, blocks in launches:
        colours = from_numpy(mi.Color3f, blocks.reshape(-1, 3))
        first = np.flatnonzero(np.r_[True, pixels[1:] != pixels[:-1]])
        end = np.r_[first[1:], len(pixels)]
        places = (n * blocks.shape[1] for n in (first, end))
        numbers = (from_numpy(mi.UInt32, n) for n in (pixels[first], *places))
        pixel, at, stop = numbers
        brightest.add(pixel, colours, at, stop)
    return brightest


def excess(*launches: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return np.stack([channel.numpy() for channel in told(*launches).excess()], axis=1)


def plain_excess(*launches: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The same, pixel by pixel."""
    of: list[list[np.ndarray]] = [[] for _ in range(WIDTH * HEIGHT)]
    for pixels, blocks in launches:
        for pixel, row in zip(pixels, blocks, strict=True):
            of[pixel] += list(row)
    found = np.zeros((WIDTH * HEIGHT, 3))
    for pixel, blocks_of in enumerate(of):
        y, x = divmod(pixel, WIDTH)
        around = [
            block.mean()
            for v in range(max(y - 1, 0), min(y + 2, HEIGHT))
            for u in range(max(x - 1, 0), min(x + 2, WIDTH))
            for block in of[v * WIDTH + u]
        ]
        limit = TOLERANCE * sorted(around)[-RIVALS] if len(around) >= RIVALS else np.inf
        for block in blocks_of:
            found[pixel] += block * (1 - min(1, limit / block.mean()))
    return found


def test_the_same_as_pixel_by_pixel():
    random = np.random.default_rng(3)
    everywhere = random.permutation(WIDTH * HEIGHT)
    again = np.repeat(everywhere, random.integers(0, 5, WIDTH * HEIGHT))
    launches = [(p, random.lognormal(0, 2, (len(p), 4, 3))) for p in (everywhere, again, again)]
    np.testing.assert_allclose(excess(*launches), plain_excess(*launches), rtol=1e-5, atol=1e-4)


def test_a_pixel_of_few_blocks():
    """Fewer than rivals are asked for, in the corner of an image that has no others."""
    pixels = np.array([0, 1])
    blocks = np.array([[[9.0, 9, 9]], [[1, 1, 1]]])
    assert not excess((pixels, blocks)).any()


def test_one_bright_block_comes_down_to_twice_the_level_around():
    pixels = np.arange(WIDTH * HEIGHT)
    blocks = np.ones((WIDTH * HEIGHT, 4, 3))
    blocks[17, 2] = [300, 600, 900]
    found = excess((pixels, blocks))
    np.testing.assert_allclose(blocks[17, 2] - found[17], [1, 2, 3], rtol=1e-5)
    assert not np.delete(found, 17, axis=0).any()


@pytest.mark.parametrize("pixels", [[17, 17, 17], [16, 17, 10], [9, 10, 17]])
def test_what_is_found_again_is_believed(pixels):
    """In one pixel, or in pixels that touch each other."""
    blocks = np.ones((WIDTH * HEIGHT, 4, 3))
    for turn, pixel in enumerate(pixels):
        blocks[pixel, turn] = 500
    assert not excess((np.arange(WIDTH * HEIGHT), blocks)).any()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_left_to_others(bad):
    """It is no rival, and is not taken away."""
    blocks = np.ones((WIDTH * HEIGHT, 4, 3))
    blocks[[16, 17, 18], 0, 1] = bad
    blocks[17, 1] = 50
    found = excess((np.arange(WIDTH * HEIGHT), blocks))
    np.testing.assert_allclose(found[17], 48, rtol=1e-5)
    assert not np.delete(found, 17, axis=0).any()


@pytest.mark.parametrize(
    ("set_size", "block"), [(4, 1), (7, 1), (8, 2), (9, 3), (12, 4), (25, 5), (30, 5), (128, 4)]
)
def test_blocks_divide_sets_evenly(set_size, block):
    assert choose_block_size(set_size) == block


def test_ordinary_noise_keeps_its_mean():
    """Up to twice as bright as its rivals is what blocks differ by themselves."""
    pixels = np.arange(WIDTH * HEIGHT)
    blocks = np.random.default_rng(5).uniform(1, 2, (len(pixels), 4, 3))
    assert not excess((pixels, blocks)).any()


@pytest.mark.parametrize("spp", [16, 20, 36, 54, 64])
@pytest.mark.parametrize("kind", ["independent", "multijitter", "ldsampler"])
def test_what_fills_a_pixel_stays_however_bright(kind, spp):
    """A small lamp: dark around, where no noise asks for more samples; these go elsewhere."""
    at = (30, 12)

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        noise = dr.select(pixel.x < 5, 2 * sampler.next_1d(), 1)
        value = dr.select((pixel.x == at[0]) & (pixel.y == at[1]), 1e4, noise)
        return [value, value, value]

    sampler = mi.load_dict({"type": kind})
    image = np.array(sample_adaptively(sample, sampler, (40, 20), spp, 3, suppress_fireflies=True))
    np.testing.assert_allclose(image[at[1], at[0]], 1e4, rtol=1e-5)
    np.testing.assert_allclose(image[:, :5].mean(), 1, atol=0.03)


def test_a_spike_of_any_height_leaves_the_rest_as_it_was():
    """A reflection of the sun in a wave."""

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        spike = (sampler.next_1d() < 1 / 64) & (pixel.x == 3) & (pixel.y == 2)
        value = dr.select(spike, mi.Float(1e9), 1)
        return [value, value, value]

    sampler = mi.load_dict({"type": "stratified"})
    images = [np.array(sample_adaptively(sample, sampler, SIZE, 64, s, True)) for s in range(8)]
    found = np.array([image[2, 3, 0] for image in images])
    # None, one or two, or as many as confirm each other.
    assert ((found == 1) | ((found > 1) & (found < 1.6)) | (found > 1e6)).all()
    assert ((found > 1) & (found < 1.6)).sum() > 2


@pytest.mark.parametrize("launch", [1 << 20, 1000])
def test_rare_samples_no_longer_dominate_the_error(launch, monkeypatch):
    """One in 30,000 is 30,000 times as bright as the rest: a pixel of 64 has 1, or 500."""
    monkeypatch.setattr("gpf.rendering.sample_sets.largest_launch", lambda: launch)

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        rare = sampler.next_1d() < 1 / 30_000
        value = dr.select(rare, mi.Float(30_000), 0.9 + 0.2 * sampler.next_1d())
        return [value, value, value, mi.Float(pixel.x)]

    sampler = mi.load_dict({"type": "multijitter"})
    plain, without = (
        np.array(sample_adaptively(sample, sampler, (64, 64), 64, 3, suppress_fireflies=suppress))
        for suppress in (False, True)
    )
    assert plain[..., 0].max() > 200
    assert without[..., 0].min() > 0.95 and without[..., 0].max() < 1.2
    np.testing.assert_allclose(without[..., 3], np.indices((64, 64))[1])
    quiet = plain[..., 0] < 1.1
    np.testing.assert_allclose(without[quiet], plain[quiet], atol=0.02)
