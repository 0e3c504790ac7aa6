"""What a recipe makes of a scene."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.core.structs import Photons
from gpf.field.initialization import InitialFieldSettings
from gpf.sppm.passes import PassSettings
from gpf.training.recipe import Recipe
from gpf.training.targets import Targets
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
    found = Recipe(InitialFieldSettings(direct=asked)).suit(scene, settings).field.direct
    if small is None:
        assert found == "field"
    else:
        every = scene.emitters()
        large = [k for k, e in enumerate(every) if mi.has_flag(e.flags(), mi.EmitterFlags.Surface)]
        assert len(found) == len(small) and len(set(found) & set(large)) == 1


def test_a_search_radius_for_which_no_search_can_be_built_is_refused():
    bounds = mi.ScalarPoint3f(-500), mi.ScalarPoint3f(500)
    recipe = Recipe(InitialFieldSettings(search_radius=1e-5))
    targets = Targets(*[np.zeros((4, 3))] * 5, source=np.zeros(4, np.int32))
    with pytest.raises(UserError, match=r"search_radius: 1e-05: is too small .* Give 0\.0002"):
        recipe.initial_field(10, dr.zeros(Photons, 10), targets, bounds)
