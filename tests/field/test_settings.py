"""Settings of a field: each emitter's direct light is stored or sampled, never both."""

from __future__ import annotations

import mitsuba as mi
import pytest

from gpf.field.settings import FieldSettings
from gpf.scene.lamps import Lamps
from tests.furnace import point_light


@pytest.mark.parametrize(
    ("direct", "stored"), [("field", {0, 1, 2}), ("emitters", set()), ((1,), {0, 2})]
)
def test_what_is_not_stored_is_sampled(direct, stored):
    lights = {f"light_{k}": point_light((k, 0, 1), 1) for k in range(3)}
    scene = mi.load_dict({"type": "scene"} | lights)

    def members(lamps: Lamps) -> set[int]:
        return {0, 1, 2} if lamps.indices is None else set(lamps.indices)

    settings = FieldSettings(search_radius=1, direct=direct)
    sampled = settings.sampled_lamps(scene)
    assert members(sampled) == {0, 1, 2} - stored and members(sampled.others()) == stored
