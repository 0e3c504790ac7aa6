"""References: views that share photons, checkpoints, and passes that know nothing of each other."""

from __future__ import annotations

from itertools import pairwise

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.images import tone_map
from gpf.core.structs import to_numpy
from gpf.sppm.passes import PassSettings, PhotonPasses
from stages.references.renderer import ReferenceRenderer, ReferenceView, film_size
from stages.references.view_samples import fixed_points
from tests.furnace import camera, cornell_box, furnace
from tests.tiers import tiers

SETTINGS = PassSettings(photons_per_pass=5000, initial_radius=0.1, direct="photons")
CAMERAS = {
    "front": camera((0, -0.2, 3.6), (0, 0, 0), 45, (8, 6)),
    "side": camera((-0.7, 0.3, 3), (0.3, -0.4, 0), 50, (5, 7)),
}


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    box = cornell_box(glass=True)
    del box["sensor"]
    return mi.load_dict(box)


def start(
    scene: mi.Scene, *names: str, seed: int = 3, settings: PassSettings = SETTINGS
) -> ReferenceRenderer:
    sensors = {name: mi.load_dict(CAMERAS[name]) for name in names}
    points = {n: fixed_points(scene, sensor, n, settings, seed) for n, sensor in sensors.items()}
    return ReferenceRenderer(scene, sensors, points, settings, seed)


def test_shapes(scene):
    renderer = start(scene, "front", "side")
    sums = renderer.run(2)
    assert film_size(renderer.sensors["side"]) == (5, 7)
    for name, (h, w) in {"front": (6, 8), "side": (7, 5)}.items():
        for key, layer in renderer.view(name, sums).layers().items():
            assert layer.shape == ((h, w) if key == "valid" else (h, w, 3)), key
            assert np.isfinite(layer).all()
    with pytest.raises(KeyError):
        renderer.view("back", sums)


def test_a_view_with_an_image_alone(scene):
    """It is that of a view with fixed points, and knows where its pixels look."""
    whole, sensors = start(scene, "front"), {"front": mi.load_dict(CAMERAS["front"])}
    image = ReferenceRenderer(scene, sensors, {}, SETTINGS, whole.seed)
    expected, found = (r.view("front", r.run(2)).layers() for r in (whole, image))
    assert set(expected) - set(found) == {"irradiance", "direct"}
    for key, layer in found.items():
        np.testing.assert_array_equal(layer, expected[key], err_msg=key)


def test_a_view_of_points_alone_has_no_image(scene):
    sensor = mi.load_dict(CAMERAS["front"])
    points = {"front": fixed_points(scene, sensor, "front", SETTINGS, 3)}
    renderer = ReferenceRenderer(scene, {}, points, SETTINGS, 3)
    view = renderer.view("front", renderer.run(1), (8, 6))
    assert view.radiance is None
    assert "radiance" not in view.layers()
    assert view.irradiance.shape == (6, 8, 3)


def test_a_view_does_not_depend_on_the_others(scene):
    """To the last bit, in whatever order threads add photons up."""

    def views(*names: str) -> dict[str, ReferenceView]:
        renderer = start(scene, *names)
        sums = renderer.run(4)
        return {name: renderer.view(name, sums) for name in names}

    together = views(*CAMERAS)
    for name in CAMERAS:
        for key, value in views(name)[name].layers().items():
            np.testing.assert_array_equal(value, together[name].layers()[key], err_msg=key)
    # Views are no copies of each other, and what is compared is not black.
    front, side = (together[name].radiance for name in ("front", "side"))
    assert front.min() >= 0 and front.mean() > 0.05
    assert side.mean() != front.mean()


def test_further_points_change_no_image(scene):
    sensor = mi.load_dict(CAMERAS["front"])
    points = {
        "front": fixed_points(scene, sensor, "front", SETTINGS, 3),
        "elsewhere": fixed_points(scene, mi.load_dict(CAMERAS["side"]), "side", SETTINGS, 3),
    }
    renderer = ReferenceRenderer(scene, {"front": sensor}, points, SETTINGS, 3)
    plain = start(scene, "front", "side")
    ours, theirs = (each.run(3) for each in (renderer, plain))
    np.testing.assert_array_equal(renderer.image("front", ours), plain.image("front", theirs))
    np.testing.assert_array_equal(
        renderer.mean_irradiance("elsewhere", ours), plain.mean_irradiance("side", theirs)
    )


def test_passes_are_independent_given_their_index(scene):
    """In any order, in any process: their sum is what a run in order finds."""
    renderer = start(scene, "front")
    points = renderer.points["front"]
    passes = PhotonPasses(scene, SETTINGS, 3)
    single = {t: to_numpy(passes.trace(t).irradiance(points)) for t in (3, 1, 2)}
    sums = renderer.run(3)
    mean = (single[1] + single[2] + single[3]) / 3
    np.testing.assert_allclose(renderer.mean_irradiance("front", sums), mean, rtol=1e-5, atol=1e-5)
    assert np.abs(single[1] - single[2]).max() > 0.1


def test_furnace_values():
    """L = 1 and E = π L / ρ at each fixed point; normals look inwards."""
    scene = mi.load_dict(furnace("point"))
    sensor = scene.sensors()[0]
    settings = PassSettings(photons_per_pass=40_000, initial_radius=0.2, direct="photons")
    points = {"view": fixed_points(scene, sensor, "view", settings, 1)}
    renderer = ReferenceRenderer(scene, {"view": sensor}, points, settings, 1)
    view = renderer.view("view", renderer.run(12))
    assert view.valid.min() == 1
    np.testing.assert_allclose(view.reflectance, 0.5, rtol=1e-5)
    np.testing.assert_allclose(view.irradiance, 2 * np.pi, rtol=0.08)
    np.testing.assert_allclose(view.radiance, 1, rtol=0.08)
    assert view.irradiance.mean() == pytest.approx(2 * np.pi, rel=0.01)
    np.testing.assert_allclose(np.linalg.norm(view.position, axis=2), 1, atol=1e-5)
    np.testing.assert_allclose(view.normal, -view.position, atol=1e-4)


def test_direct_light_of_fixed_points_by_samples_of_the_emitters(scene):
    """The same irradiance as by photons, about half of it direct light."""
    # The ratio of means has a standard error of 0.5 %.
    by_photons, by_samples = (
        start(
            scene,
            "front",
            settings=SETTINGS.model_copy(update={"photons_per_pass": 50_000, "direct": direct}),
        )
        for direct in ("photons", "emitters")
    )
    photon_sums, sample_sums = by_photons.run(20), by_samples.run(20)
    photons = by_photons.mean_irradiance("front", photon_sums)
    samples = by_samples.mean_irradiance("front", sample_sums)
    direct = by_samples.mean_direct("front", sample_sums)
    assert samples.mean() == pytest.approx(photons.mean(), rel=0.02)
    np.testing.assert_array_less(direct, samples + 1e-6)
    assert direct.mean() == pytest.approx(samples.mean(), rel=0.6) and direct.min() >= 0
    assert by_photons.mean_direct("front", photon_sums).max() == 0
    view = by_samples.view("front", sample_sums)
    np.testing.assert_array_equal(view.direct.reshape(-1, 3), direct)


def test_pixels_lie_where_the_camera_sees_them():
    """Within the pixel whose centre a ray of the camera goes through: no axis is swapped."""
    scene = mi.load_dict(furnace("point"))
    sensor = scene.sensors()[0]
    points = {"view": fixed_points(scene, sensor, "view", SETTINGS, 1)}
    renderer = ReferenceRenderer(scene, {"view": sensor}, points, SETTINGS, 1)
    view = renderer.view("view", renderer.run(1))
    y, x = (np.indices((6, 8)) + 0.5).reshape(2, -1).astype(np.float32)
    ray, _ = sensor.sample_ray(0, 0, mi.Point2f(x / 8, y / 6), mi.Point2f(0.5))
    centre = to_numpy(ray.d).reshape(6, 8, 3)
    seen = view.position - to_numpy(ray.o).reshape(-1, 1, 3)[0]
    seen /= np.linalg.norm(seen, axis=2, keepdims=True)
    half_diagonal = np.hypot(0.5, 0.5) * 2 * np.tan(np.radians(30)) / 8
    off = np.linalg.norm(seen - centre, axis=2)
    assert off.max() < half_diagonal
    assert off.mean() > half_diagonal / 10  # samples lie anywhere in their pixels


def test_progress_is_told_pass_by_pass(scene):
    renderer, told = start(scene, "front"), []
    sums = renderer.run(3, tick=told.append)
    renderer.run(3, sums, told.append)
    renderer.run(5, sums, told.append)
    assert told == [1, 2, 3, 4, 5] and sums.passes == 5


@tiers(quick=1 / 4)
def test_the_standard_error_is_that_of_independent_runs(scene, tier):
    """Without a shrinking radius, for its bias is none of the noise.

    The ratio of both has a standard error of 3 %, or 8 % in the quick tier.
    """
    settings = SETTINGS.model_copy(update={"alpha": 0.999})
    sensor = mi.load_dict(camera((0, -0.2, 3.6), (0, 0, 0), 45, (16, 12)))
    seeds, passes = (24, 16) if tier.share == 1 else (12, 8)
    images, errors = [], []
    for seed in range(seeds):
        renderer = ReferenceRenderer(scene, {"front": sensor}, {}, settings, seed)
        view = renderer.view("front", renderer.run(passes))
        images.append(view.radiance)
        errors.append(view.standard_error)
    measured = np.sqrt(np.mean(np.var(images, axis=0, ddof=1)))
    estimated = np.sqrt(np.mean(np.square(errors)))
    assert estimated == pytest.approx(measured, rel=tier.noise(0.1))


def test_the_expected_psnr_is_what_independent_runs_have(scene):
    sensor = mi.load_dict(camera((0, -0.2, 3.6), (0, 0, 0), 45, (48, 40)))
    runs = [ReferenceRenderer(scene, {"view": sensor}, {}, SETTINGS, seed) for seed in range(6)]
    sums = [renderer.run(16) for renderer in runs]
    estimated = [each.views["view"].expected_psnr(16, exposure=1.0) for each in sums]
    mapped = [tone_map(r.image("view", s), 1.0) for r, s in zip(runs, sums, strict=True)]
    measured = [-10 * np.log10(np.mean((a - b) ** 2)) for a, b in pairwise(mapped)]
    assert np.mean(estimated) == pytest.approx(np.mean(measured), abs=0.5)
    assert np.std(estimated) < 1
