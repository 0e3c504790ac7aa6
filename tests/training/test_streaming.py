"""Streaming supervision: what is learned from is the mean so far, and all turns are taken."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.random import pass_seed
from gpf.core.structs import VisiblePoints, to_numpy
from gpf.photons.tracing import PathSettings, record_photons
from gpf.sppm.passes import PassSettings
from gpf.training.kernel_width import COMPARED, choose_kernels, is_sharp, kernel_blur, pick
from gpf.training.streaming import PhotonStream
from gpf.training.targets import Targets
from tests.furnace import diffuse, floor, point_light

SETTINGS = PassSettings(photons_per_pass=4000, initial_radius=0.3, direct="photons")


def targets_of(stream: PhotonStream) -> Targets:
    return stream.mean(stream.halves())


def make_stream(settings: PassSettings = SETTINGS, seed: int = 3) -> PhotonStream:
    light = point_light((0, 0, 1), 2, 1, 0.5)
    scene = mi.load_dict({"type": "scene", "floor": floor(diffuse(0.5)), "light": light})
    place = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 300)).astype(np.float32)
    points = dr.zeros(VisiblePoints, 300)
    points.p = mi.Point3f(*place, dr.zeros(mi.Float, 300))
    points.n = dr.full(mi.Normal3f, 0, 300)
    points.n.z = dr.full(mi.Float, 1, 300)
    points.valid = dr.full(mi.Bool, True, 300)
    points.reflectance = mi.Color3f(0.5)
    dr.make_opaque(points)
    points.valid &= dr.arange(mi.UInt32, 300) % 3 != 0  # those in between are of no use
    return PhotonStream(scene, settings, {"view": points}, seed=seed)


def radius_of_pass(t: int, first: float) -> float:
    """By the recurrence r_{t+1} = r_t √((t + α) / (t + 1))."""
    for k in range(1, t):
        first *= ((k + SETTINGS.alpha) / (k + 1)) ** 0.5
    return first


def irradiance_at(position: np.ndarray) -> np.ndarray:
    """Of the light on the floor, W/m²: I cos θ / d², (N, 3)."""
    squared = (position**2).sum(axis=1) + 1
    return np.array([2, 1, 0.5]) / squared[:, None] ** 1.5


def test_targets_are_what_all_photons_so_far_say():
    """Added up one by one, with the last pass's radius for all: E = 2 / (π r²) Σ (1 - d²/r²) Φ."""
    stream = make_stream()
    stream.advance(3)
    targets, radius = targets_of(stream), radius_of_pass(3, 0.3)
    expected = np.zeros(targets.irradiance.shape)
    for t in (1, 2, 3):
        photons = record_photons(stream.scene, PathSettings(4000), seed=pass_seed(3, t, stream=0))
        offset = targets.position[:, None] - to_numpy(photons.p)
        share = np.maximum(1 - (offset**2).sum(axis=-1) / radius**2, 0)
        expected += 2 / (np.pi * radius**2) * share @ to_numpy(photons.power) / 3
    difference = targets.irradiance - expected
    assert np.sqrt(np.mean(difference**2)) < 1e-3 * expected.mean()
    assert targets.irradiance.mean() == pytest.approx(expected.mean(), rel=2e-4)
    assert targets.direct.max() == 0


def test_halves_have_other_photons_for_the_same_points():
    """Their errors are independent, and as large as the photons are few: with λ photons per m²,
    all of the same power, the smooth kernel has the variance E² 4 / (3 π r² λ)."""
    stream = make_stream(SETTINGS.model_copy(update={"initial_radius": 0.08}))
    stream.advance(8)
    even, odd = stream.halves()
    np.testing.assert_array_equal(even.position, odd.position)
    known = irradiance_at(even.position)
    per_area = 4 * SETTINGS.photons_per_pass * known[:, :1] / (4 * np.pi * 2)
    variance = 4 / (3 * np.pi * radius_of_pass(8, 0.08) ** 2 * per_area)
    expected = np.sqrt(np.mean(known**2 * variance))
    errors = [part.irradiance - known for part in (even, odd, stream.mean((even, odd)))]
    size = [np.sqrt(np.mean(error**2)) for error in errors]
    # Over seeds, these have a standard deviation of 6 %: neighbouring points share photons.
    assert np.hypot(*size[:2]) / 2**0.5 == pytest.approx(expected, rel=0.25)
    assert size[2] * 2**0.5 == pytest.approx(expected, rel=0.25)
    correlation = np.corrcoef(errors[0].mean(axis=1), errors[1].mean(axis=1))[0, 1]
    assert abs(correlation) < 0.35


def test_an_odd_number_of_passes_has_halves_of_different_weight():
    stream = make_stream()
    stream.advance(3)
    even, odd = stream.halves()
    expected = even.irradiance / 3 + 2 * odd.irradiance / 3
    np.testing.assert_allclose(stream.mean((even, odd)).irradiance, expected, rtol=1e-5)


def test_direct_light_may_come_from_samples_of_the_emitters():
    """Of a point light they know all at once: I cos θ / d² at every point, with no photon."""
    stream = make_stream(SETTINGS.model_copy(update={"direct": "emitters"}))
    stream.advance(2)
    targets = targets_of(stream)
    assert len(targets.source) == 200 and set(targets.source) == {0}
    expected = irradiance_at(targets.position)
    np.testing.assert_allclose(targets.direct, expected, rtol=1e-4)
    np.testing.assert_allclose(targets.irradiance, expected, rtol=1e-4)


def test_light_is_sharp_where_the_wide_kernel_has_a_bias_and_the_narrow_one_little_noise():
    """Three cells: a bias of 1 with noise 0.1; no bias; a bias of 1 in noise of 1."""
    rng, cell = np.random.default_rng(2), np.repeat([0, 1, 2], 400)
    position = np.zeros((1200, 3))
    position[:, 0] = cell + rng.uniform(0.1, 0.9, 1200)
    normal = np.broadcast_to([0.0, 0.0, 1.0], (1200, 3))
    bias, noise = np.array([1, 0, 1])[cell], np.array([0.1, 0.1, 1])[cell]

    def gathered(add: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
        halves = [add + share * noise * rng.normal(size=1200) for _ in range(2)]
        return tuple(np.repeat(half[:, None], 3, axis=1) for half in halves)

    wide, narrow = gathered(bias, 0.5), gathered(0 * bias, 1.0)
    sharp = is_sharp(position, normal, wide, narrow, radius=1 / COMPARED)
    assert [sharp[cell == k].mean() for k in range(3)] == [1, 0, 0]


def test_the_narrowest_kernel_is_for_what_the_second_does_not_resolve():
    """Four cells, by the biases of the kernels: none; of the first; of the first and the second,
    which agree, as beside a bright surface; of both, but in noise."""
    rng, cell = np.random.default_rng(3), np.repeat(np.arange(4), 400)
    position = np.zeros((1600, 3))
    position[:, 0] = cell + rng.uniform(0.1, 0.9, 1600)
    normal = np.broadcast_to([0.0, 0.0, 1.0], (1600, 3))
    biases = [0, 1, 1, 1], [0, 0, 1, 1], [0, 0, 0, 0]
    noises = [0.02, 0.02, 0.02, 1], [0.05, 0.05, 0.05, 2], [0.1, 0.1, 0.1, 4]

    def halves(bias: list[float], noise: list[float]) -> tuple[np.ndarray, np.ndarray]:
        level, sigma = np.array(bias, float)[cell], np.array(noise)[cell]
        both = [level + sigma * rng.normal(size=1600) for _ in range(2)]
        return tuple(np.repeat(half[:, None], 3, axis=1) for half in both)

    gathered = [halves(*each) for each in zip(biases, noises, strict=True)]
    chosen = choose_kernels(position, normal, gathered, radius=1 / COMPARED)
    assert [set(chosen[cell == k]) for k in range(4)] == [{0}, {1}, {2}, {0}]
    light = pick(chosen, gathered)
    np.testing.assert_array_equal(light[1][cell == 2], gathered[2][1][cell == 2])
    blur = kernel_blur(chosen, gathered)
    assert [blur[cell == k].mean() for k in range(3)] == pytest.approx([0, 0, 1 / 16], abs=0.01)


def test_the_narrow_kernel_is_not_for_places_with_large_cubes():
    """Of few points on an evenly lit floor, many photons would show the single cubes."""
    light = {"type": "directional", "direction": [0, 0, -1]}
    scene = mi.load_dict({"type": "scene", "floor": floor(diffuse(0.5)), "light": light})
    place = np.random.default_rng(1).uniform(-2, 2, (2, 200)).astype(np.float32)
    points = dr.zeros(VisiblePoints, 200)
    points.p = mi.Point3f(*place, dr.zeros(mi.Float, 200))
    points.n = mi.Normal3f(0, 0, 1) + dr.zeros(mi.Normal3f, 200)
    points.valid = dr.full(mi.Bool, True, 200)
    dr.make_opaque(points)
    settings = PassSettings(photons_per_pass=400_000, initial_radius=0.08, direct="photons")
    stream = PhotonStream(scene, settings, {"view": points}, seed=3)
    stream.advance(20)
    even, _ = stream.halves()
    expected = even.irradiance.mean()
    assert np.abs(even.irradiance / expected - 1).max() < 0.15
    assert not stream.blur.any()
    stream.photons.coarse[:] = False  # what it would be without the rule
    stream.halves()
    assert stream.blur.mean() > 1e-3 * expected**2
