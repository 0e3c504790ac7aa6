"""AOVs, against Mitsuba's own integrators and against what is known."""

import mitsuba as mi
import numpy as np
import pytest

import gpf  # noqa: F401  # registers the plugins
from gpf.core.images import tone_map
from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.rendering.aovs import (
    AOVS,
    MOST_ERROR,
    channel_names,
    expected_psnr,
    parse_aovs,
    split_layers,
)
from tests.plain_field import flat_gaussians, to_device

WIDTH, HEIGHT = 20, 12
E = np.array([2.0, 3.0, 5.0])
ERROR = 0.04
ALBEDO, GREEN, TINT = np.array([0.2, 0.5, 0.8]), np.array([0.0, 0.6, 0.0]), 0.75


def make_scene(middle: dict | None = None) -> mi.Scene:
    """A floor seen from above and from the side, with a green wall, a lamp in the picture and, if
    asked for, a plate of the material ``middle`` above a part of the floor."""
    t = mi.ScalarTransform4f

    def rectangle(to_world, material, **more):
        return {"type": "rectangle", "to_world": to_world, "bsdf": material, **more}

    return mi.load_dict(
        {
            "type": "scene",
            "sensor": {
                "type": "perspective",
                "to_world": t().look_at([1, -6, 5], [0, 0, 0.5], [0, 0, 1]),
                "fov": 50,
                "sampler": {"type": "independent"},
                "film": {
                    "type": "hdrfilm",
                    "width": WIDTH,
                    "height": HEIGHT,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgb",
                    "component_format": "float32",
                },
            },
            "floor": rectangle(t().scale([3, 3, 1]), diffuse(ALBEDO)),
            "wall": rectangle(
                t().translate([0, 3, 3]).rotate([1, 0, 0], 90).scale([3, 3, 1]), diffuse(GREEN)
            ),
            **(
                {"plate": rectangle(t().translate([-0.8, -0.5, 1]), middle)}
                if middle is not None
                else {}
            ),
            "lamp": rectangle(
                t().translate([1.5, 1, 1.5]).rotate([1, 0, 0], 90).scale(0.8),
                {"type": "conductor", "specular_reflectance": 0.0},
                emitter={"type": "area", "radiance": {"type": "rgb", "value": [9.0, 0.5, 0.0]}},
            ),
        }
    )


def diffuse(colour) -> dict:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [float(c) for c in colour]}}


# It tints and reflects nothing.
GLASS = {
    "type": "thindielectric",
    "int_ior": 1.0,
    "ext_ior": 1.0,
    "specular_transmittance": TINT,
}


def constant_field(scene, relative=ERROR, direct="field") -> GaussianPhotonField:
    """E on the floor and on the wall, with a relative error."""
    grid = np.stack(np.meshgrid(np.linspace(-3, 3, 13), np.linspace(-3, 3, 13)), -1).reshape(-1, 2)
    floor = np.column_stack([grid, np.zeros(len(grid))])
    g = flat_gaussians(floor, np.tile(E, (len(floor), 1)), size=0.3)
    bounds = scene.bbox().min, scene.bbox().max
    error = np.full(len(floor), relative, np.float32)
    settings = FieldSettings(search_radius=0.8, direct=direct)
    return GaussianPhotonField(to_device(g), settings, bounds, error=error)


def render(scene, aovs, spp=256, field=None, **options):
    integrator = mi.load_dict({"type": "gpf", "aovs": ",".join(aovs), **options})
    integrator.field = field or constant_field(scene)
    image = np.array(mi.render(scene, integrator=integrator, spp=spp, seed=1))
    return split_layers(image, aovs)


@pytest.mark.parametrize("adaptive", [False, True])
def test_the_first_surface_is_that_of_mitsubas_aov(adaptive):
    scene = make_scene(GLASS)
    ours = render(scene, ["depth", "position", "normal"], adaptive=adaptive)
    theirs = mi.load_dict(
        {
            "type": "aov",
            "aovs": "d:depth,p:position,n:sh_normal",
            "image": {"type": "direct"},
        }
    )
    image = np.array(mi.render(scene, integrator=theirs, spp=256, seed=2))
    pairs = {
        "depth": (ours["depth"][..., None], image[..., 3:4]),
        "position": (ours["position"], image[..., 4:7]),
        "normal": (ours["normal"], image[..., 7:10]),
    }
    for name, (a, b) in pairs.items():
        # The same where a pixel shows a single surface; with noise along edges.
        assert np.median(np.abs(a - b)) < 0.01, name
        np.testing.assert_allclose(a.mean((0, 1)), b.mean((0, 1)), atol=0.03)


def test_what_is_seen_in_glass_has_its_own_albedo_and_normal():
    layers = render(make_scene(GLASS), ["albedo", "visible_normal", "irradiance", "depth"])
    bare = render(make_scene(), ["albedo", "visible_normal", "irradiance", "depth"])
    nearer = bare["depth"] - layers["depth"]
    plate = nearer > 0.85 * nearer.max()  # whole pixels of it
    assert plate.sum() >= 6
    np.testing.assert_allclose(
        layers["albedo"][plate], TINT * bare["albedo"][plate], rtol=0.05, atol=0.02
    )
    for name in ("visible_normal", "irradiance"):
        np.testing.assert_allclose(layers[name][plate], bare[name][plate], rtol=0.05, atol=0.05)
    floor = (np.abs(bare["albedo"] - ALBEDO) < 1e-4).all(-1)
    assert floor.sum() >= 30
    np.testing.assert_allclose(bare["visible_normal"][floor], [[0, 0, 1]] * floor.sum(), atol=1e-5)
    np.testing.assert_allclose(bare["irradiance"][floor], np.tile(E, (floor.sum(), 1)), rtol=0.02)


def test_lamps_have_an_albedo_of_at_most_one_and_no_irradiance():
    layers = render(make_scene(), ["albedo", "irradiance", "visible_normal"])
    lamp = layers["radiance"][..., 0] > 8.9
    assert lamp.sum() >= 2
    np.testing.assert_allclose(layers["albedo"][lamp], [[1, 0.5, 0]] * lamp.sum(), atol=0.01)


@pytest.mark.parametrize("direct", ["emitters", (0,)])
@pytest.mark.parametrize("options", [{}, {"adaptive": True}, {"record": True}])
def test_irradiance_is_all_the_light_that_the_picture_has(options, direct):
    """Also where lamps are sampled: what the field does not store. In floors, and in glass."""
    scene = make_scene(GLASS)
    field = constant_field(scene, direct=direct)
    layers = render(scene, ["irradiance", "albedo"], spp=1024, field=field, **options)
    level = layers["albedo"] / ALBEDO
    whole = np.minimum(np.abs(level - 1), np.abs(level - TINT))  # not at its edges
    floor = (whole < 1e-3).all(-1)
    assert floor.sum() >= 40
    found = layers["irradiance"][floor]
    seen = np.pi * layers["radiance"][floor] / layers["albedo"][floor]
    assert (found[:, 0] > 1.2 * E[0]).mean() > 0.3  # the lamp is red
    np.testing.assert_allclose(found.mean(axis=0), seen.mean(axis=0), rtol=0.01)
    assert np.corrcoef(found[:, 0], seen[:, 0])[0, 1] > 0.99


def test_the_error_is_a_share_of_the_radiance_and_lamps_have_none():
    layers = render(make_scene(), ["error", "albedo"])
    lamp = layers["radiance"][..., 0] > 8.9
    assert (layers["error"][lamp] < 1e-3).all()
    floor = (np.abs(layers["albedo"] - ALBEDO) < 1e-4).all(-1)
    assert floor.sum() >= 30
    np.testing.assert_allclose(layers["error"][floor], ERROR, rtol=1e-3)


def test_an_error_beyond_all_light_is_shown_as_all_light():
    """Ten times the light: a few such samples beside a shadow would decide that of a picture."""
    scene = make_scene()
    layers = render(scene, ["error"], field=constant_field(scene, relative=10))
    assert layers["error"].max() == pytest.approx(MOST_ERROR)
    assert expected_psnr(layers["radiance"], layers["error"], 0.1) > 0


def test_a_field_without_error_says_so():
    scene = make_scene()
    integrator = mi.load_dict({"type": "gpf", "aovs": "error"})
    integrator.field = constant_field(scene)
    integrator.field.update(integrator.field.gaussians)  # what was known is no longer right
    with pytest.raises(RuntimeError) as caught:
        mi.render(scene, integrator=integrator, spp=4)
    assert "does not know its error" in str(caught.value.__cause__)


def test_the_expected_psnr_is_that_of_an_image_with_such_errors():
    rng = np.random.default_rng(2)
    radiance = rng.uniform(0.05, 1.5, (40, 60, 3))
    error = rng.uniform(0, 0.03, (40, 60))
    wrong = radiance * (1 + error[..., None] * rng.choice([-1, 1], (40, 60, 1)))
    difference = tone_map(wrong, 0.8) - tone_map(radiance, 0.8)
    measured = -10 * np.log10(np.mean(difference**2))
    assert expected_psnr(radiance, error, 0.8) == pytest.approx(measured, abs=0.3)


def test_radiance_does_not_depend_on_the_channels_beside_it():
    scene = make_scene(GLASS)
    plain, all_of_them = render(scene, []), render(scene, AOVS)
    assert list(all_of_them) == ["radiance", *AOVS]
    np.testing.assert_allclose(plain["radiance"], all_of_them["radiance"], rtol=1e-5, atol=1e-6)
    for name in AOVS:
        assert np.isfinite(all_of_them[name]).all() and all_of_them[name].any(), name


def test_names_of_channels_are_those_that_viewers_know():
    assert channel_names(["albedo", "depth"]) == ["albedo.R", "albedo.G", "albedo.B", "depth"]
    assert parse_aovs(" depth , albedo,depth ") == ("depth", "albedo")
    assert parse_aovs("") == ()


def test_another_name_is_an_error_that_lists_the_names():
    with pytest.raises(RuntimeError, match="unknown name 'colour'; choose from depth, position"):
        mi.load_dict({"type": "gpf", "aovs": "colour"})
