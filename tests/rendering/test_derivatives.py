"""Derivatives of pictures: against finite differences with the same samples, and Mitsuba's."""

import re
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import gpf  # noqa: F401  # registers the plugins
from gpf.core.structs import from_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.io import save_field
from gpf.field.lights import FieldLights
from gpf.field.settings import FieldSettings
from gpf.scene.light_groups import LightGroups
from tests.plain_field import random_gaussians, to_device

SIZE, SPP, SEED = 12, 16, 3
BOUNDS = [-2.0, -2.0, 0.0], [2.0, 2.0, 3.5]
NO_PANE = {"type": "sphere", "radius": 0.01, "center": [1.9, 1.9, 3.4]}


def make_scene(**more) -> mi.Scene:
    """A floor that fills the view, half of it under a pane of glass, and two lamps behind the
    camera."""
    pixels = np.linspace(0.2, 0.8, 4 * 4 * 3, dtype=np.float32).reshape(4, 4, 3)
    texture = {"type": "bitmap", "data": mi.TensorXf(pixels), "raw": True}
    ball = {"type": "sphere", "radius": 0.1}
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": [9.0, 7, 5]}}
    lift = mi.ScalarTransform4f()
    return mi.load_dict(
        {
            "type": "scene",
            "floor": {
                "type": "rectangle",
                "to_world": lift.scale(2),
                "bsdf": {"type": "diffuse", "reflectance": texture},
            },
            "pane": {
                "type": "rectangle",
                "to_world": lift.translate([1, 0, 0.4]),
                "bsdf": {"type": "thindielectric"},
            },
            "one": {**ball, "center": [-1.0, 1, 3.4], "emitter": lamp},
            "other": {**ball, "center": [1.0, -1, 3.4], "emitter": dict(lamp)},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": lift.look_at([0.1, -0.3, 3], [0, 0, 0], [0, 1, 0]),
                "film": {
                    "type": "hdrfilm",
                    "width": SIZE,
                    "height": SIZE,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgb",
                },
            },
            **more,
        }
    )


@pytest.fixture(autouse=True)
def no_shared_answers(monkeypatch):
    """Finite differences show the jump where another sample begins to answer for many."""
    monkeypatch.setattr("gpf.rendering.gpf.GroupedWalks", lambda walks, *_: walks)


def make_field(direct: str = "field") -> GaussianPhotonField:
    """Many Gaussians near the floor."""
    rng = np.random.default_rng(8)
    g = random_gaussians(rng, 500, sizes=(0.2, 0.6))
    g.means[:] = rng.uniform(-2, 2, (500, 3)) * [1, 1, 0.02]
    settings = FieldSettings(
        search_radius=0.6, k=3, neighbours="radius", normal_test=False, direct=direct
    )
    return GaussianPhotonField(to_device(g), settings, BOUNDS)


def make_integrator(field: GaussianPhotonField) -> mi.Integrator:
    integrator = mi.load_dict({"type": "gpf"})
    integrator.field = field
    return integrator


def render(scene, integrator, params=None) -> mi.TensorXf:
    """Without ``params``, with the samples of the derivative."""
    own = {"seed": SEED} if params is None else {"seed": SEED + 1, "seed_grad": SEED}
    return mi.render(scene, params, integrator=integrator, spp=SPP, **own)


WEIGHTS = np.random.default_rng(2).normal(size=(SIZE, SIZE, 3)).astype(np.float32)


def loss(image: mi.TensorXf) -> mi.Float:
    return dr.sum(dr.ravel(image * from_numpy(mi.TensorXf, WEIGHTS)))


def precise_loss(image: mi.TensorXf) -> float:
    """In double precision: a sum in single precision would hide small differences."""
    return float((np.array(image, dtype=float) * WEIGHTS).sum())


def both_modes(scene, integrator, owner, key: str, step: float) -> tuple[float, float, float]:
    """The derivative along a random direction: backward, forward, and by finite differences."""
    params = mi.traverse(owner)
    value = params[key]
    kind, before = type(value), np.array(value)
    direction = np.random.default_rng(4).normal(size=before.shape).astype(np.float32)

    def convert(numbers: np.ndarray):
        if kind is mi.Float or kind is mi.TensorXf:
            return from_numpy(kind, numbers)
        return kind(*(from_numpy(mi.Float, row) for row in np.atleast_2d(numbers)))

    def set_to(numbers: np.ndarray):
        new = convert(numbers)
        params[key] = new
        return new

    sides = []
    for sign in (1, -1):
        set_to(before + sign * step * direction)
        params.update()
        sides.append(precise_loss(render(scene, integrator)))
    new = set_to(before)
    dr.enable_grad(new)
    params[key] = new
    params.update()
    dr.backward(loss(render(scene, integrator, params)))
    back = float((np.array(dr.grad(params[key])) * direction).sum())
    new = convert(before)
    dr.enable_grad(new)
    dr.set_grad(new, convert(direction))
    params[key] = new
    params.update()
    total = loss(render(scene, integrator, params))
    ahead = float(dr.forward_to(total)[0])
    set_to(before)  # no longer attached
    return back, ahead, (sides[0] - sides[1]) / (2 * step)


def assert_near(found: Any, expected: Any, limit: float) -> None:
    """Prints the relative difference, which `pytest -rP` shows."""
    difference = np.linalg.norm(np.subtract(found, expected)) / np.linalg.norm(expected)
    print(f"relative difference: {difference:.1e}, limit {limit:g}")
    assert difference < limit


@pytest.mark.parametrize(
    ("name", "step"), [("means", 1e-3), ("log_scales", 1e-2), ("quats", 2e-3), ("irradiance", 1e-2)]
)
def test_arrays_of_the_field(name, step):
    scene, integrator = make_scene(pane=NO_PANE), make_integrator(make_field())
    back, ahead, differences = both_modes(scene, integrator, integrator, f"field.{name}", step)
    assert_near(back, differences, 0.01)
    assert_near(ahead, back, 1e-3)


@pytest.mark.parametrize("direct", ["field", "emitters"])
def test_a_texture(direct):
    scene, integrator = make_scene(pane=NO_PANE), make_integrator(make_field(direct))
    key = "floor.bsdf.reflectance.data"
    back, ahead, differences = both_modes(scene, integrator, scene, key, 1e-2)
    assert_near(back, differences, 0.01)
    assert_near(ahead, back, 1e-3)


def with_groups() -> GaussianPhotonField:
    """A field that keeps both lamps apart."""
    field = make_field("emitters")
    total = np.array(field.gaussians.irradiance).T
    groups = LightGroups(("left", "right"), ((0,), (1,)))
    field.lights = FieldLights(groups, np.stack([0.3 * total, 0.7 * total]))
    return field


def test_levels_of_lamps():
    scene, integrator = make_scene(), make_integrator(with_groups())
    for name in ("left", "right"):
        # Light is linear, and a level is not negative.
        back, ahead, differences = both_modes(scene, integrator, integrator, f"levels.{name}", 0.1)
        assert_near(back, differences, 1e-3)
        assert_near(ahead, back, 1e-3)


@pytest.mark.parametrize("direct", ["field", "emitters"])
def test_the_camera_moves(direct):
    """Without the pane: behind it, the camera counts as fixed."""
    scene = make_scene(pane=NO_PANE)
    integrator = make_integrator(make_field(direct))
    sensor = scene.sensors()[0]
    params = mi.traverse(scene)
    start = mi.Transform4f(params["sensor.to_world"])

    def put(amount: mi.Float) -> None:
        along = mi.Transform4f().translate(amount * mi.Vector3f(0.3, 0.5, -0.4))
        params["sensor.to_world"] = along @ start @ mi.Transform4f().rotate([0, 0, 1], 20 * amount)
        params.update()

    step, sides = 1e-3, []
    for sign in (1, -1):
        put(mi.Float(sign * step))
        sides.append(precise_loss(render(scene, integrator)))
    amount = mi.Float(0)
    dr.enable_grad(amount)
    put(amount)
    dr.backward(loss(render(scene, integrator, params)))
    assert_near(dr.grad(amount)[0], (sides[0] - sides[1]) / (2 * step), 0.01)
    assert sensor is scene.sensors()[0]


def test_the_gradient_of_mitsuba_for_direct_light():
    """A black field: what is left is the light of the lamps."""
    field = make_field("emitters")
    field.recolour(np.zeros((500, 3)))
    key, found = "floor.bsdf.reflectance.data", []
    for integrator in (make_integrator(field), mi.load_dict({"type": "path", "max_depth": 2})):
        scene = make_scene(pane=NO_PANE)
        params = mi.traverse(scene)
        dr.enable_grad(params[key])
        params.update()
        image = mi.render(scene, params, integrator=integrator, spp=4096, seed=1)
        dr.backward(loss(image))
        found.append(np.array(dr.grad(params[key])))
    assert_near(*found, 0.01)


def test_a_field_of_a_scene_is_among_its_parameters(tmp_path):
    save_field(make_field(), tmp_path / "field.safetensors")
    own = {"type": "gpf", "field": str(tmp_path / "field.safetensors")}
    scene = make_scene(integrator=own)
    params = mi.traverse(scene)
    before = np.array(mi.render(scene, spp=1, seed=1))
    (key,) = (key for key, _ in params.items() if key.endswith("field.irradiance"))
    params[key] = 2 * params[key]
    dr.enable_grad(params[key])
    params.update()
    image = mi.render(scene, params, spp=1, seed=1)
    np.testing.assert_allclose(np.array(image), 2 * before, rtol=1e-5)
    dr.backward(loss(image))
    assert np.abs(np.array(dr.grad(params[key]))).max() > 0


def test_images_are_the_same_with_and_without_derivatives():
    scene, field = make_scene(), make_field("emitters")
    integrator = make_integrator(field)
    plain = np.array(render(scene, integrator))
    params = mi.traverse(integrator)
    dr.enable_grad(params["field.means"])
    params.update()
    image = mi.render(scene, params, integrator=integrator, spp=SPP, seed=SEED)
    np.testing.assert_array_equal(np.array(image), plain)


def told(words: str, total: mi.Float) -> None:
    """That its gradient is refused. Dr.Jit wraps the message in others."""
    with pytest.raises(RuntimeError) as raised:
        dr.backward(total)
    error, said = raised.value, []
    while error is not None:
        said.append(str(error))
        error = error.__cause__
    assert re.search(words, " ".join(said))


def raises(scene, integrator, owner, key: str, words: str) -> None:
    params = mi.traverse(owner)
    dr.enable_grad(params[key])
    params.update()
    told(words, loss(render(scene, integrator, params)))


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("one.emitter.radiance.value", "one.emitter.radiance.value, a value of an emitter"),
        ("pane.to_world", "pane.to_world, a part of the geometry"),
    ],
)
def test_what_has_no_derivative(key, words):
    scene = make_scene()
    raises(scene, make_integrator(make_field()), scene, key, f"no derivative.*{words}")


@pytest.mark.parametrize(
    ("name", "words"), [("adaptive", "adaptive samples"), ("denoise", "denoiser")]
)
def test_modes_that_have_no_derivative(name, words):
    integrator = make_integrator(make_field())
    scene = make_scene()
    params = mi.traverse(integrator)
    dr.enable_grad(params["field.means"])
    params.update()
    image = render(scene, integrator, params)
    setattr(integrator, name, True)
    told(f'{words} cannot be.* "{name}" to false', loss(image))


def test_aovs_have_no_derivative():
    integrator = make_integrator(make_field())
    integrator.aovs = ("depth",)
    told("AOVs have no derivative", dr.sum(dr.ravel(image_of(integrator))))
    dr.backward(loss(image_of(integrator)[..., :3]))


def test_a_level_of_groups_that_are_no_longer_kept_apart():
    integrator = make_integrator(with_groups())
    params = mi.traverse(integrator)
    params["field.irradiance"] = params["field.irradiance"] * 2
    params.update()
    dr.enable_grad(params["levels.left"])
    told("levels.left: the field no longer keeps", loss(render(make_scene(), integrator, params)))


@pytest.mark.parametrize("color", ["luminance", "xyz"])
def test_levels_in_films_that_are_not_rgb(color):
    film = {"type": "hdrfilm", "width": 8, "height": 8, "pixel_format": color}
    scene = make_scene(sensor={"type": "perspective", "film": film})
    integrator = make_integrator(with_groups())
    params = mi.traverse(integrator)
    dr.enable_grad(params["levels.left"])
    told("in films of RGB only", dr.sum(dr.ravel(render(scene, integrator, params))))


def test_what_is_not_finite_is_named():
    integrator = make_integrator(make_field())
    params = mi.traverse(integrator)
    params["field.means"] = mi.Point3f(dr.full(mi.Float, dr.nan, 500))
    with pytest.raises(RuntimeError, match="field.means has values that are not finite"):
        params.update()
    integrator = make_integrator(make_field())
    told("gradient of the image is not finite", loss(image_of(integrator)) * mi.Float(dr.nan))
    integrator = make_integrator(make_field())
    sizes = np.array(integrator.field.gaussians.log_scales)
    sizes[:, 250:] = -100  # their inverses are infinite
    mi.traverse(integrator)["field.log_scales"] = from_numpy(mi.Vector3f, sizes.T)
    told("The gradient of field.quats is not finite", loss(image_of(integrator, "field.quats")))


def image_of(integrator, key: str = "field.irradiance") -> mi.TensorXf:
    params = mi.traverse(integrator)
    dr.enable_grad(params[key])
    params.update()
    return render(make_scene(), integrator, params)
