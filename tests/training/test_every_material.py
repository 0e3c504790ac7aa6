"""Each material keeps the light: photons, rays that end in a field, and the field itself.

`pytest -s -m "" tests/training/test_every_material.py` prints the table of docs/own_scene.md.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import Photons, concatenate
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.sensors import views_of_sensors
from gpf.sppm.passes import PassSettings
from gpf.training.streaming import PhotonStream
from stages.config.training import FieldTrainingSettings
from stages.training.recipe import Recipe
from tests.furnace import Scene, bitmap, camera, diffuse, lamp, rgb, sppm, two_sided
from tests.training.test_gathered_light import BOUNDS, on_walls, points_at

COLOUR = rgb(0.8, 0.6, 0.3)
PLASTIC = {"type": "roughplastic", "diffuse_reflectance": COLOUR, "alpha": 0.25}
TILTED = np.array([0.2, -0.1, 0.97]) / np.linalg.norm([0.2, -0.1, 0.97])


def principled(**more: float) -> Scene:
    return {"type": "separable_principled", "base_color": COLOUR, "roughness": 0.5} | more


def sheet(diff_trans: float) -> Scene:
    kind = "separable_principledthin"
    return {"type": kind, "base_color": COLOUR, "roughness": 0.6, "diff_trans": diff_trans}


MATERIALS = {
    "diffuse": diffuse(0.8, 0.6, 0.3),
    "plastic": {"type": "plastic", "diffuse_reflectance": COLOUR},
    "roughplastic": PLASTIC,
    "principled, roughness .1": principled(roughness=0.1),
    "principled, roughness .5": principled(),
    "principled, roughness 1": principled(roughness=1.0),
    "principled, metallic .5": principled(metallic=0.5),
    "principled, clearcoat": principled(clearcoat=1.0),
    "principled, spec_trans": principled(spec_trans=0.6),
    "principledthin, diff_trans 0": sheet(0.0),
    "principledthin, diff_trans 1": sheet(1.0),
    "principledthin, diff_trans 2": sheet(2.0),
    "blendbsdf": {
        "type": "blendbsdf",
        "weight": 0.4,
        "diffuse": diffuse(0.8, 0.6, 0.3),
        "metal": {"type": "roughconductor", "alpha": 0.3},
    },
    "mask": {"type": "mask", "opacity": 0.6, "material": two_sided(0.8, 0.6, 0.3)},
    "twosided": {"type": "twosided", "material": PLASTIC},
    "bumpmap": {
        "type": "bumpmap",
        "material": diffuse(0.8, 0.6, 0.3),
        "relief": bitmap(np.random.default_rng(2).uniform(0, 0.1, (8, 9, 1))),
    },
    "normalmap": {
        "type": "normalmap",
        "material": diffuse(0.8, 0.6, 0.3),
        "normalmap": bitmap(np.broadcast_to((TILTED + 1) / 2, (2, 2, 3))),
    },
}
PANEL = mi.ScalarTransform4f().translate([-0.2, 0.1, 0]).rotate([1, 0, 0], 10)
HALF = 0.75, 0.85


def closed_room(bsdf: Scene) -> Scene:
    """A room with a lamp at the ceiling, and a panel across it, which most light has to pass."""
    size = mi.ScalarTransform4f().scale([*HALF, 1])
    return {
        "type": "scene",
        "sensor": camera((0.9, 0.9, 0.6), (-0.5, -0.5, -0.3), 90, (24, 18)),
        "room": {"type": "cube", "flip_normals": True, "bsdf": diffuse(0.6)},
        "lamp": lamp((0, 0, 0.9), (0, 0, 0), 0.6, 1),
        "panel": {"type": "rectangle", "to_world": PANEL @ size, "bsdf": bsdf},
    }


def on_panel(count: int, up: float):
    rng = np.random.default_rng(4)
    frame = np.array(PANEL.matrix)
    place = rng.uniform(-1, 1, (count, 2)) * HALF
    p = place @ frame[:3, :2].T + frame[:3, 3]
    return points_at(p, np.tile(up * frame[:3, 2], (count, 1)))


SIMILAR = (
    "plastic",
    "principled, roughness .1",
    "principled, roughness 1",
    "principled, clearcoat",
    "principledthin, diff_trans 0",
    "principledthin, diff_trans 2",
    "twosided",
    "normalmap",
)
"""Materials like others; the nightly tests look at them."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=pytest.mark.long if k in SIMILAR else ()) for k in MATERIALS],
)
def test_a_material_keeps_the_light(kind):
    """By photons (`sppm`), by rays that end in a field of these photons, and in the field that
    learns from both; against Mitsuba's path tracer.

    For masks, Mitsuba's ``path`` (3.9) counts the opacity twice, ``prb`` once.
    """
    scene = mi.load_dict(closed_room(MATERIALS[kind]))
    path = {"type": "prb" if kind == "mask" else "path", "max_depth": -1}
    truth = np.array(mi.render(scene, integrator=mi.load_dict(path), spp=1024, seed=1))
    image = np.array(mi.render(scene, integrator=mi.load_dict(sppm(radius=0.03)), spp=24))

    settings = PassSettings(photons_per_pass=100_000, initial_radius=0.06)
    panel = next(shape for shape in scene.shapes() if shape.id() == "panel")
    both = mi.has_flag(panel.bsdf().flags(), mi.BSDFFlags.BackSide)
    sides = [on_panel(5000, up) for up in ((1, -1) if both else (1,))]
    points = {"all": concatenate([on_walls(15_000), *sides])}
    stream = PhotonStream(scene, settings, points, seed=3)
    stream.advance(12)
    recipe = Recipe(train=FieldTrainingSettings(steps=60))

    def fit():
        halves = stream.halves()
        mean = stream.mean(halves)
        field = recipe.fit_stream(stream, halves, dr.zeros(Photons, 0), BOUNDS).run()
        return field, (mean.irradiance - mean.direct).mean()

    draft, indirect = fit()
    stream.light_by(draft)
    stream.gathered.add(4)
    field, gathered = fit()
    renderer = FieldRenderer.make(scene, field, RenderSettings(spp=1024))
    shown = renderer.render(views_of_sensors(scene)[0], (24, 18), seed=2)["radiance"]
    ratios = image.mean() / truth.mean(), shown.mean() / truth.mean(), gathered / indirect
    print(f"\n| {kind} | {ratios[0]:.3f} | {ratios[1]:.3f} | {ratios[2]:.3f} |", end=" ")
    np.testing.assert_allclose(ratios, 1, atol=0.01)
