"""The system on surfaces, where it fails by a known factor."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from baselines.em_gmm.baseline import EmGmm, PreparedMixture, plane_thickness
from baselines.em_gmm.mixture_density import MixtureDensity
from baselines.options import EmGmmOptions
from baselines.protocol import CannotServe, Task
from gpf.core.structs import from_numpy, to_numpy
from gpf.scene.views import View
from tests.baselines.known_mixture import densities, known_mixture
from tests.furnace import Scene, diffuse, floor, furnace, lamp, point_light, rgb

INSIDE = View(name="inside", origin=(0.3, 0.2, 0.1), target=(1, 0.5, 0.4), fov=60)
ABOVE = View(name="above", origin=(0.1, 0.2, 2), target=(0, 0, 0), fov=50)


def task(scene: Scene, folder: Path, size: tuple[int, int] = (8, 6), **more: Any) -> Task:
    return Task(
        name="test",
        scene=mi.load_dict(scene),
        file=folder / "scene.xml",
        size=size,
        exposure=1,
        training=(),
        rr_depth=5,
        seed=3,
        state=folder,
        **more,
    )


def to_points(x: np.ndarray) -> mi.Point3f:
    return from_numpy(mi.Point3f, x)


def prepare(job: Task, **options: Any) -> PreparedMixture:
    return EmGmm(EmGmmOptions(system="em_gmm", **options)).prepare(job)


def test_the_density_is_that_of_the_mixture():
    rng = np.random.default_rng(0)
    mixture = replace(known_mixture(), flux=rng.uniform(0.5, 2, (4, 3)))
    lower, upper = np.array([-2.5, -3, -1.5]), np.array([3.5, 3.5, 3])
    x = rng.uniform(lower, upper, (5000, 3))
    density = MixtureDensity(mixture, (lower, upper))
    points = to_points(x)
    found = to_numpy(density(points))
    expected = densities(mixture, x) @ mixture.flux
    # Gaussians end at four standard deviations.
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=4e-4 * expected.max())
    # The flux comes back as an integral over the volume: that is the normalisation.
    axes = [np.linspace(a, b, 100) for a, b in zip(lower, upper, strict=True)]
    everywhere = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    step = np.prod([axis[1] - axis[0] for axis in axes])
    integral = step * to_numpy(density(to_points(everywhere))).sum(axis=0, dtype=np.float64)
    np.testing.assert_allclose(integral, mixture.flux.sum(axis=0), rtol=5e-3)
    half = from_numpy(mi.Bool, np.arange(5000) % 2 == 0)
    np.testing.assert_array_equal(to_numpy(density(points, half))[1::2], 0)
    np.testing.assert_array_equal(to_numpy(density(points, half))[::2], found[::2])


def test_components_of_very_different_sizes_are_all_found():
    rng = np.random.default_rng(1)
    mixture = known_mixture()
    deviations = np.array([1e-3, 0.02, 0.3, 5])[:, None] * rng.uniform(0.5, 2, (4, 3))
    turns = np.linalg.eigh(mixture.covariances)[1]
    covariances = np.einsum("kij,kj,klj->kil", turns, deviations**2, turns)
    mixture = replace(
        mixture, covariances=covariances, flux=deviations.prod(axis=1)[:, None] + np.zeros(3)
    )
    near = mixture.means[rng.integers(0, 4, 2000)] + rng.normal(size=(2000, 3)) * 2e-3
    x = np.concatenate([near, rng.uniform(-2, 2, (2000, 3))])
    points = to_points(x)
    found = to_numpy(MixtureDensity(mixture, ([-2, -2, -2], [2, 2, 2]))(points))
    expected = densities(mixture, to_numpy(points).astype(float)) @ mixture.flux
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize("bandwidth", [0.05, 0.1])
def test_a_plane_is_too_bright_by_one_over_its_thickness(tmp_path, bandwidth):
    """Light falls straight down on a plane: the irradiance is known, and so is the failure."""
    scene = {
        "type": "scene",
        "floor": floor(diffuse(0.6), size=4),
        "light": {"type": "directional", "direction": [0, 0, -1], "irradiance": rgb(1, 2, 3)},
    }
    job = task(scene, tmp_path)
    options = {"components": 100, "paths": 40_000, "bandwidth": bandwidth}
    right = 0.6 / np.pi * np.array([1, 2, 3])
    prepared = prepare(job, **options)
    image = prepared.render(ABOVE, seed=1)
    factor = 1 / (np.sqrt(2 * np.pi) * bandwidth)
    np.testing.assert_allclose(image.mean((0, 1)), factor * right, rtol=0.05)
    assert prepared.facts["factor_on_planes"] == pytest.approx(factor)
    mended = prepare(job, **options, normalisation="plane")
    np.testing.assert_allclose(mended.render(ABOVE, seed=1), image / factor, rtol=1e-5)
    assert mended.facts["factor_on_planes"] == pytest.approx(1)


def test_the_unit_of_length_changes_the_image(tmp_path):
    """The same room in units half as long: its radiance stays, the method's estimate does not."""
    images = []
    for unit in (1, 2):
        sphere = {"type": "sphere", "radius": unit, "flip_normals": True, "bsdf": diffuse(0.5)}
        light = point_light((0, 0, 0), np.pi * unit**2)
        view = View(name="inside", origin=(0, 0, 0), target=(1, 0.5, 0.4), fov=60)
        job = task({"type": "scene", "sphere": sphere, "light": light}, tmp_path)
        options = {"components": 64, "paths": 20_000}
        images.append(
            [
                prepare(job, **options, normalisation=kind).render(view, seed=1).mean()
                for kind in ("volume", "plane")
            ]
        )
    (volume, plane), (volume_in_halves, plane_in_halves) = images
    assert volume_in_halves == pytest.approx(volume / 2, rel=0.02)
    assert plane_in_halves == pytest.approx(plane, rel=0.02)


def test_in_a_furnace_the_radiance_is_one(tmp_path):
    """Radiance 1 everywhere. A sphere is nearly a plane to narrow Gaussians."""
    reports: list[tuple[int, int]] = []
    job = task(furnace("point"), tmp_path, report=lambda *at: reports.append(at))
    options = {"components": 1000, "paths": 50_000, "passes": 4, "spp": 16}
    prepared = prepare(job, **options)
    assert reports == [(1, 4), (2, 4), (3, 4), (4, 4)]
    image = prepared.render(INSIDE, seed=2)
    assert image.shape == (6, 8, 3) and image.dtype == np.float32
    ratio = image * plane_thickness(prepared.bandwidth)
    assert ratio.mean() == pytest.approx(1, abs=0.1)
    assert ratio.std() < 0.15
    # 12 numbers of 4 bytes for each Gaussian; all photons' flux is in them.
    assert prepared.storage_bytes == 48 * len(prepared.mixture)
    assert 990 <= len(prepared.mixture) <= 1000
    total = 4 * np.pi * np.pi * 2
    np.testing.assert_allclose(prepared.mixture.flux.sum(axis=0), total, rtol=0.02)
    json.dumps(prepared.facts)


def test_the_same_seed_gives_the_same_image(tmp_path):
    job = task(furnace("point"), tmp_path)
    options = {"components": 40, "paths": 3000, "spp": 2}
    first, again = (prepare(job, **options).render(INSIDE, seed=2) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    prepared = prepare(job, **options)
    assert (prepared.render(INSIDE, seed=3) != first).any()
    other = prepare(replace(job, seed=4), **options)
    assert (other.mixture.means[0] != prepared.mixture.means[0]).any()


def test_a_lamp_has_its_own_radiance(tmp_path):
    """A black lamp in front of the camera: no photon counts there, and emission is not scaled."""
    scene = {
        "type": "scene",
        "lamp": lamp((0, 0, 0.5), (0, 0, 2), 4, 3, 2, 1),
        "bulb": point_light((0, 0, 1.5), 1),
        "floor": floor(diffuse(0.5), z=-3),
    }
    job = task(scene, tmp_path)
    image = prepare(job, components=10, paths=2000).render(ABOVE, seed=1)
    np.testing.assert_allclose(image, np.broadcast_to([3, 2, 1], image.shape), rtol=1e-5)


def test_images_are_as_wide_as_asked(tmp_path):
    prepared = prepare(task(furnace("point"), tmp_path, (5, 9)), components=8, paths=500, spp=1)
    assert prepared.render(INSIDE, seed=1).shape == (9, 5, 3)


def test_what_it_cannot_serve_it_refuses_in_words(tmp_path):
    dark = {"type": "scene", "floor": floor(diffuse(0.5)), "light": point_light((0, 0, 1), 0)}
    with pytest.raises(CannotServe, match="test: no photon lands on a diffuse surface. Check"):
        prepare(task(dark, tmp_path), components=8, paths=100)
    lit = dark | {"light": point_light((0, 0, 1), 1)}
    with pytest.raises(CannotServe, match="bandwidth of 1e-09 is lost in rounding. Give .* or mo"):
        prepare(task(lit, tmp_path), components=8, paths=100, bandwidth=1e-9)
    narrow = prepare(task(lit, tmp_path), components=8, paths=100, bandwidth=1e-4)
    least = np.linalg.eigvalsh(narrow.mixture.covariances)[:, 0]
    np.testing.assert_allclose(least, 1e-8, rtol=0.01)
    principled = {"type": "principled"}
    scene = {"type": "scene", "floor": floor(principled), "light": point_light((0, 0, 1), 1)}
    with pytest.raises(CannotServe, match="test: materials of type principled.*Use"):
        prepare(task(scene, tmp_path), components=8, paths=100)


def test_bad_options_are_errors():
    for wrong in ({"components": 0}, {"bandwidth": 0}, {"bandwidth": "wide"}, {"passes": 0}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            EmGmmOptions(system="em_gmm", **wrong)
