"""What a recipe makes of a scene."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.core.structs import Photons, VisiblePoints, from_numpy
from gpf.field.settings import sampled_lamps
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings
from gpf.training.direct_light import choose_direct
from gpf.training.streaming import PhotonStream
from gpf.training.targets import Targets
from stages.config.training import InitialFieldSettings
from stages.training.recipe import Recipe
from tests.furnace import diffuse, floor, lamp, point_light

LAMPS = {
    "bulb": point_light((0, 0, 1), 1),
    "panel": lamp((0, 0, 2), (0, 0, 0), 1, 1, 1, 1),
    "spark": lamp((1, 0, 2), (0, 0, 0), 0.01, 1, 1, 1),
}


@pytest.mark.parametrize(
    ("asked", "passes", "names", "small"),
    [
        ("auto", "emitters", {"bulb", "panel", "spark"}, {"bulb", "spark"}),
        ("auto", "emitters", {"panel"}, None),
        ("auto", "photons", {"bulb", "panel"}, None),
        ("field", "emitters", {"bulb", "panel"}, None),
    ],
)
def test_small_lamps_are_left_to_samples(asked, passes, names, small):
    lamps = {name: LAMPS[name] for name in names}
    scene = mi.load_dict({"type": "scene", "floor": floor(diffuse(0.5))} | lamps)
    settings = PassSettings(initial_radius=0.1, direct=passes)
    found = choose_direct(scene, settings, asked)
    if small is None:
        assert found == "field"
    else:
        every = scene.emitters()
        large = [k for k, e in enumerate(every) if mi.has_flag(e.flags(), mi.EmitterFlags.Surface)]
        assert len(found) == len(small) and len(set(found) & set(large)) == 1


BEAM = lamp((0, 0, 2), (0, 0, 0), 0.5, 1) | {
    "emitter": {"type": "directionalarea", "radiance": {"type": "rgb", "value": 2.0}}
}


@pytest.mark.parametrize("asked", ["emitters", "bulb"])
@pytest.mark.parametrize("lights", [("bulb", "panel"), ("bulb", "beam")])
def test_direct_light_counts_once(lights, asked):
    """What a stream teaches the field and what the renderer samples are all light together, also
    if the beam leaves direct light to photons."""
    scene = mi.load_dict(
        {"type": "scene", "floor": floor(diffuse(0.5))}
        | {name: (LAMPS | {"beam": BEAM})[name] for name in lights},
        optimize=False,
    )
    kinds = [emitter.class_name() for emitter in scene.emitters()]
    direct = asked if asked == "emitters" else (kinds.index("PointLight"),)
    passes = PassSettings(photons_per_pass=300_000, initial_radius=0.3)
    recipe = Recipe(InitialFieldSettings(direct=direct)).suit(scene, passes)
    place = np.random.default_rng(1).uniform(-0.2, 0.2, (400, 2))
    points = dr.zeros(VisiblePoints, 400)
    points.p = from_numpy(mi.Point3f, np.column_stack([place, np.zeros(400)]))
    points.n = mi.Normal3f(0, 0, 1) + dr.zeros(mi.Normal3f, 400)
    points.valid = dr.full(mi.Bool, True, 400)
    direct = recipe.field.direct
    lamps = None if direct == "emitters" else sampled_lamps(scene, direct).others()
    stream = PhotonStream(scene, passes, {"view": points}, seed=1, lamps=lamps)
    stream.advance(8)
    stored = np.array(recipe.supervise(stream.mean(stream.halves())).target).mean()
    fixed = FixedPoints(scene, points)
    sampled = fixed.mean_direct(sampled_lamps(scene, direct), 64, seed=2).mean()
    whole = PhotonStream(
        scene, passes.model_copy(update={"direct": "photons"}), {"view": points}, seed=3
    )
    whole.advance(8)
    every = whole.mean(whole.halves()).irradiance.mean()
    assert sampled > 0.2 * every
    assert stored + sampled == pytest.approx(every, rel=0.02)


def test_a_search_radius_for_which_no_search_can_be_built_is_refused():
    bounds = mi.ScalarPoint3f(-500), mi.ScalarPoint3f(500)
    recipe = Recipe(InitialFieldSettings(search_radius=1e-5))
    targets = Targets(*[np.zeros((4, 3))] * 5, source=np.zeros(4, np.int32))
    with pytest.raises(UserError, match=r"search_radius: 1e-05: is too small .* Give 0\.0002"):
        recipe.initial_field(10, dr.zeros(Photons, 10), targets, bounds)
