"""Images of a field where the answer is known."""

import mitsuba as mi
import numpy as np
import pytest

from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.scene.bounds import scene_bounds
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.furnace import diffuse, floor
from tests.rendering.textured_floor import (
    HEIGHT,
    LAMP,
    TEXELS,
    WIDTH,
    E,
    constant_field,
    integrator_with,
    make_scene,
)


def reflectance_seen(scene: mi.Scene) -> np.ndarray:
    """What Mitsuba's own integrator says about the albedo in each pixel."""
    albedo = mi.load_dict({"type": "aov", "aovs": "albedo:albedo"})
    return np.array(mi.render(scene, integrator=albedo, spp=4))[..., -3:]


@pytest.mark.parametrize("stores", ["irradiance", "radiance"])
def test_a_constant_field_shows_the_texture_and_the_lamp(stores):
    scene = make_scene()
    albedo = reflectance_seen(scene)
    lamp = np.isclose(albedo, 0.5).all(axis=-1)
    assert np.argwhere(lamp).shape == (1, 2)
    # The picture of the floor is the texture: nothing is mirrored or transposed beyond Mitsuba's
    # own conventions, and all texels are there.
    assert set(np.unique(albedo[~lamp].round(5))) < set(np.unique(TEXELS.round(5)))
    assert np.unique(albedo[~lamp].round(5)).size == 3 * (WIDTH * HEIGHT - 1)

    integrator = integrator_with(constant_field(stores))
    image = np.array(mi.render(scene, integrator=integrator, spp=4, seed=3))
    reflected = albedo / np.pi * E if stores == "irradiance" else np.broadcast_to(E, albedo.shape)
    np.testing.assert_allclose(image, reflected + lamp[..., None] * LAMP, rtol=1e-4)


def test_coverage_tells_where_the_field_had_to_reach():
    scene = make_scene()
    integrator = integrator_with(constant_field(), aovs="coverage")
    image = np.array(mi.render(scene, integrator=integrator, spp=64))
    assert image.shape == (HEIGHT, WIDTH, 4)
    coverage = image[..., 3]
    # The Gaussians begin at x = -2, the floor at x = -4, which is the left or right picture edge.
    ends = coverage[:, 0], coverage[:, -1]
    far, near = ends if ends[0].mean() > ends[1].mean() else ends[::-1]
    assert (far > 1.5).all() and (far < 4).all()
    np.testing.assert_allclose(near, 1, rtol=1e-5)
    plain = np.array(mi.render(scene, integrator=integrator_with(constant_field()), spp=64))
    np.testing.assert_allclose(image[..., :3], plain, rtol=1e-5)


@pytest.mark.parametrize("pixels", ["rgb", "rgba"])
@pytest.mark.parametrize("suppress_fireflies", [False, True])
def test_adaptive_samples_make_the_same_picture(pixels, suppress_fireflies):
    scene = make_scene()
    sensor = make_scene(pixels).sensors()[0]
    plain = integrator_with(constant_field(), aovs="coverage")
    adaptive = integrator_with(
        constant_field(), aovs="coverage", adaptive=True, suppress_fireflies=suppress_fireflies
    )
    a, b = (
        np.array(mi.render(scene, sensor=sensor, integrator=i, spp=64)) for i in (plain, adaptive)
    )
    assert a.shape == b.shape
    np.testing.assert_allclose(a[..., :-1], b[..., :-1], rtol=1e-4)
    np.testing.assert_allclose(a[..., -1], b[..., -1], rtol=0.15)  # random at the floor's end


def test_fireflies_are_suppressed_where_that_is_asked_for(asked_to_suppress):
    for suppress in (False, True):
        integrator = integrator_with(constant_field(), adaptive=True, suppress_fireflies=suppress)
        mi.render(make_scene(), integrator=integrator, spp=16)
    assert asked_to_suppress == [False, True]


def test_adaptive_samples_need_pixels_that_keep_to_themselves():
    scene = make_scene()
    sensor = mi.load_dict({"type": "perspective", "film": {"type": "hdrfilm"}})
    integrator = integrator_with(constant_field(), adaptive=True)
    with pytest.raises(RuntimeError, match='<rfilter type="box"/>'):
        integrator.render(scene, sensor, spp=16)
    integrator.render(scene, sensor, spp=1)  # too few to tell


def test_where_the_field_knows_nothing_coverage_does_not_look_like_support():
    scene = make_scene()
    field = constant_field()
    field = GaussianPhotonField(
        field.gaussians, FieldSettings(search_radius=0.8, neighbours="radius"), field.bounds
    )
    image = np.array(mi.render(scene, integrator=integrator_with(field, aovs="coverage"), spp=16))
    ends = image[:, 0], image[:, -1]
    unknown = ends[0] if ends[0][:, :3].sum() < ends[1][:, :3].sum() else ends[1]
    np.testing.assert_array_equal(unknown[:, :3], 0)  # nothing within 0.8 of these pixels
    assert (unknown[:, 3] > 4).all()


def test_max_depth_is_that_of_path():
    scene = make_scene()
    field = constant_field()
    for depth in (0, 1):
        image = np.array(
            mi.render(scene, integrator=integrator_with(field, max_depth=depth), spp=2)
        )
        path = mi.load_dict({"type": "path", "max_depth": depth})
        np.testing.assert_allclose(
            image, np.array(mi.render(scene, integrator=path, spp=2)), atol=1e-6
        )
    reflects = np.array(mi.render(scene, integrator=integrator_with(field, max_depth=2), spp=2))
    assert (reflects > 0).all()


@pytest.mark.parametrize(
    ("surface", "least"),
    [
        # It reflects so much that the bright sky is in every sample, or in four times as many.
        ({"type": "thindielectric", "int_ior": 3.0}, 0.1),
        ({"type": "thindielectric", "int_ior": 1.5}, 0.6),
        ({"type": "plastic", "int_ior": 3.0}, 0.1),
        ({"type": "plastic", "int_ior": 1.5}, 0.6),
        # A sample of the second way may be zero, and says nothing of the next one.
        ({"type": "mask", "opacity": 0.5, "inner": diffuse(0.5)}, 1),
        ({"type": "roughplastic", "alpha": 0.4}, 1),
    ],
)
@pytest.mark.parametrize("adaptive", [False, True])
def test_both_ways_from_a_surface_make_the_same_picture_with_less_noise(
    monkeypatch, surface, least, adaptive
):
    parts = {"floor": floor(diffuse(0.5)), "sheet": floor(surface, z=0.2)}
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [20, 20, 20]}}
    scene = mi.load_dict({"type": "scene", "sky": sky} | parts)
    sensor = make_sensor(View(name="it", origin=(0, -2, 2), target=(0, 0, 0), fov=20), 32, 32)
    field, means, noise = constant_field(), [], []
    field.bounds = scene_bounds(scene)
    for divided in (True, False):
        aovs = "irradiance,visible_normal"
        integrator = integrator_with(field, aovs=aovs, adaptive=adaptive)
        if not divided:
            monkeypatch.setattr("gpf.rendering.recording.divides_walks", lambda scene: False)
        a, b = (
            mi.render(scene, sensor=sensor, integrator=integrator, spp=324, seed=seed).numpy()
            for seed in (1, 2)
        )
        means.append((a + b).mean(axis=(0, 1)) / 2)
        noise.append((a - b)[..., 0].std())
    np.testing.assert_allclose(means[0], means[1], rtol=0.01, atol=1e-4)
    if not adaptive:
        assert noise[0] < least * noise[1]


def test_recorded_frames_are_those_of_a_new_integrator():
    """Seeds, cameras, textures, fields and films may change between frames of one integrator."""
    scene = make_scene()
    narrow, wide = (
        mi.load_dict(
            {
                "type": "perspective",
                "to_world": above(5),
                "film": {"type": "hdrfilm", "width": w, "height": h, "rfilter": {"type": "box"}},
            }
        )
        for w, h in ((8, 6), (12, 4))
    )
    kept = mi.load_dict({"type": "gpf", "record": True})
    kept.field = constant_field()
    dim = constant_field()
    dim.gaussians.irradiance *= 0.5
    dim.update(dim.gaussians)

    def check(seed: int, sensor=narrow, spp: int = 4) -> np.ndarray:
        new = mi.load_dict({"type": "gpf", "record": True})
        new.field = kept.field
        options = {"sensor": sensor, "seed": seed, "spp": spp}
        image = np.array(mi.render(scene, integrator=kept, **options))
        np.testing.assert_array_equal(image, np.array(mi.render(scene, integrator=new, **options)))
        return image

    for seed in range(4):
        check(seed)
    before = check(5)
    camera = mi.traverse(narrow)
    camera["to_world"] = above(4)
    camera.update()
    assert not np.array_equal(check(5), before)
    before = check(5)
    parameters = mi.traverse(scene)
    texture = next(key for key in parameters.keys() if key.endswith("reflectance.data"))  # noqa: SIM118
    parameters[texture] = parameters[texture] * 0.5
    parameters.update()
    assert check(5).sum() < before.sum()
    kept.field = dim
    check(6)
    for seed in range(3):
        assert check(seed, sensor=wide, spp=2).shape == (4, 12, 3)
    check(7)


def above(height: float) -> mi.ScalarTransform4f:
    return mi.ScalarTransform4f().look_at([0.2, 0, height], [0, 0, 0], [0, 1, 0])
