"""Samples and pixels: as Mitsuba has them, but the same every time."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import gpf.rendering.sppm as sppm_plugin
from gpf.camera.film import reconstruct, sample_film, sample_grid
from gpf.core.structs import from_numpy
from tests.furnace import Scene, camera, cornell_box, sppm, z_scores
from tests.tiers import tiers

FILTERS = ["box", "tent", "gaussian", "mitchell", "lanczos"]


def film_of(filter_: str, **more: object) -> mi.Film:
    return mi.load_dict(
        {"type": "hdrfilm", "width": 12, "height": 9, "rfilter": {"type": filter_}} | more
    )


CROP = {"crop_offset_x": 3, "crop_offset_y": 2, "crop_width": 7, "crop_height": 5}


FILMS = {
    "plain": {},
    "border": {"sample_border": True},
    "crop": CROP,
    "alpha": {"pixel_format": "rgba"},
}


def is_slow(film: str, filter_: str) -> bool:
    """The kernels of the widest filter take 3 s to compile; the border is where width matters."""
    return filter_ == "lanczos" and film != "border"


@pytest.mark.parametrize(
    ("filter_", "more"),
    [
        pytest.param(f, FILMS[film], id=f"{film}-{f}", marks=[pytest.mark.slow] * is_slow(film, f))
        for film in FILMS
        for f in FILTERS
    ],
)
def test_pixels_are_those_of_mitsuba(filter_, more):
    film = film_of(filter_, **more)
    width, height = sample_grid(film)
    border = (width - int(film.crop_size()[0])) // 2
    rng = np.random.default_rng(1)
    y, x = np.indices((height, width)).reshape(2, -1) - border
    corner = np.array(film.crop_offset())
    place = np.stack([x, y], axis=1) + corner + rng.random((width * height, 2))
    position = from_numpy(mi.Point2f, place)
    radiance = from_numpy(mi.Color3f, rng.random((width * height, 3)))
    alpha = from_numpy(mi.Float, rng.random(width * height))

    film.prepare([])
    film.put_block(mi.ImageBlock(reconstruct(film, position, radiance, alpha), film.crop_offset()))
    ours = np.array(film.develop())

    film.prepare([])
    block = film.create_block()
    block.set_coalesce(False)
    channels = [*radiance, *([alpha] if "pixel_format" in more else []), mi.Float(1)]
    where = mi.Point2f(mi.Point2i(position)) if filter_ == "box" else position
    block.put(where, channels)
    film.put_block(block)
    theirs = np.array(film.develop())
    assert ours.shape == theirs.shape and theirs.std() > 0.02
    # Mitsuba looks its filters up in a table.
    np.testing.assert_allclose(ours, theirs, rtol=0.03, atol=0.01)


def test_samples_lie_in_their_pixels_and_see_what_the_camera_sees():
    scene = mi.load_dict(cornell_box((12, 9)))
    sensor = scene.sensors()[0]
    for rows in (range(9), range(4, 7)):
        samples = sample_film(scene, sensor, seed=1, rows=rows)
        place = samples.position.numpy().T
        y, x = np.indices((len(rows), 12)).reshape(2, -1)
        np.testing.assert_array_equal(np.floor(place), np.stack([x, y + rows.start], axis=1))
        ray, _ = sensor.sample_ray(0, 0, samples.position / mi.Point2f(12, 9), mi.Point2f(0.5))
        hit = scene.ray_intersect(ray)
        np.testing.assert_allclose(samples.points.p.numpy(), hit.p.numpy(), atol=1e-4)


def render(scene: Scene, seed: int = 3) -> np.ndarray:
    loaded = mi.load_dict(scene)
    return np.array(mi.render(loaded, spp=4, seed=seed))


def small_box(filter_: str = "gaussian", **options: object) -> Scene:
    film = {"type": "hdrfilm", "width": 24, "height": 18, "rfilter": {"type": filter_}}
    sensor = camera((0, -0.2, 3.6), (0, 0, 0), 45, (24, 18)) | {"film": film}
    integrator = sppm(photons=5000, radius=0.1) | options
    return cornell_box((24, 18), glass=True) | {"sensor": sensor, "integrator": integrator}


@pytest.mark.parametrize("direct", ["photons", "emitters"])
@pytest.mark.parametrize("filter_", ["box", "gaussian"])
def test_one_seed_gives_one_image_on_any_number_of_threads(filter_, direct):
    scene, before = small_box(filter_, direct=direct), dr.thread_count()
    images = [render(scene)]
    try:
        for threads in (1, 2, 5):
            dr.set_thread_count(threads)
            images.append(render(scene))
    finally:
        dr.set_thread_count(before)
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])
    assert (render(scene, seed=4) != images[0]).mean() > 0.5


@pytest.mark.slow
def test_large_films_are_rendered_in_bands(monkeypatch):
    """With samples of their own, and the photons of the whole film."""
    whole = np.stack([render(small_box(), seed=s) for s in range(8)])
    monkeypatch.setattr(sppm_plugin, "MOST_POINTS", 100)
    film = mi.load_dict(small_box()["sensor"]).film()
    bands = list(sppm_plugin.split_rows(film))
    assert [len(rows) for rows in bands] == [4, 4, 4, 4, 2]
    assert [y for rows in bands for y in rows] == list(range(18))
    banded = np.stack([render(small_box(), seed=s) for s in range(8)])
    assert banded.mean() == pytest.approx(whole.mean(), rel=0.01)
    # Rows on either side of the bands' edges agree: no seam. A row's mean has a standard error of
    # 1 to 3 %, or 10 % where it has the lamp's edge or the caustic.
    assert z_scores(whole.mean((2, 3)), banded.mean((2, 3))).max() < 4


# --- several walks where the first surface is glossy ------------------------------------------

METAL = {"type": "twosided", "m": {"type": "roughconductor", "material": "Al", "alpha": 0.3}}


def metal_box(filter_: str = "box", **integrator: object) -> Scene:
    scene = small_box(filter_)
    return scene | {"glass": scene["glass"] | {"bsdf": METAL}, "integrator": integrator}


def test_only_gloss_is_walked_from_again():
    scene = mi.load_dict(metal_box(**sppm()))
    sensor = scene.sensors()[0]
    once, many = (sample_film(scene, sensor, seed=1, walks=walks) for walks in (1, 5))
    split = np.array(many.split)
    count = 24 * 18
    assert 20 < len(split) < count / 3
    assert dr.width(many.points.p) == count + 4 * len(split)
    np.testing.assert_array_equal(many.points.p.numpy()[:, :count], once.points.p.numpy())
    # The further walks begin alike and end elsewhere.
    depth = np.array(many.points.depth)
    assert (depth[split] >= 1).all() and (np.delete(depth[:count], split) == 0).all()
    again = many.points.p.numpy()[:, count:].reshape(3, 4, -1)
    moved = np.abs(again - many.points.p.numpy()[:, None, split]).max((0, 1)) > 1e-3
    assert moved.mean() > 0.85  # some escape, and have no place


def test_walks_of_a_ray_are_averaged():
    scene = mi.load_dict(metal_box(**sppm()))
    samples = sample_film(scene, scene.sensors()[0], seed=1, walks=3)
    count, split = 24 * 18, np.array(samples.split)
    rng = np.random.default_rng(1)
    value = rng.random((3, dr.width(samples.points.p))).astype(np.float32)
    merged = samples.merge(mi.Color3f(value)).numpy()
    expected = value[:, :count].copy()
    further = value[:, count:].reshape(3, 2, -1)
    expected[:, split] = (value[:, split] + further.sum(1)) / 3
    np.testing.assert_allclose(merged, expected, rtol=1e-6)


def test_radiance_is_computed_once_for_all_channels():
    """It is the search for photons: three times that was most of a pass."""
    scene = mi.load_dict(metal_box(**sppm()))
    samples = sample_film(scene, scene.sensors()[0], seed=1, walks=3)
    dr.eval(samples)
    size = dr.width(samples.points.p)
    radiance = mi.Color3f(dr.sqrt(samples.points.p))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dr.eval(samples.merge(radiance))
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert [k["size"] for k in kernels].count(size) == 1


@pytest.mark.slow
@tiers(quick=1 / 6)
def test_more_walks_have_less_noise_and_the_same_mean(tier):
    """The ratio of means has a standard error of 1.4 %, or 3.5 % in the quick tier."""
    seeds, spp, photons = (48, 8, 20_000) if tier.share == 1 else (16, 4, 5000)
    options = sppm(photons=photons, radius=0.15)
    means, errors, noise = [], [], []
    for walks in (1, 8):
        scene = mi.load_dict(metal_box(**options | {"glossy_walks": walks}))
        images = np.stack([np.array(mi.render(scene, spp=spp, seed=s)) for s in range(seeds)])
        gloss = np.zeros(24 * 18, bool)
        gloss[np.array(sample_film(scene, scene.sensors()[0], seed=1, walks=2).split)] = True
        sphere = images.reshape(seeds, -1, 3)[:, gloss]
        means.append(sphere.mean())
        errors.append(sphere.mean((1, 2)).std(ddof=1) / seeds**0.5)
        noise.append(np.median(sphere.var(0)))  # not that of the silhouette
        rest = images.reshape(seeds, -1, 3)[:, ~gloss]
        assert rest.mean() > 0.1
    error = np.hypot(*errors)
    assert error < tier.noise(0.02) * means[0]
    assert abs(means[1] - means[0]) < 3.5 * error
    assert noise[1] < 0.5 * noise[0]
