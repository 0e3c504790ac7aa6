"""The Cornell box is Mitsuba's."""

import mitsuba as mi
import numpy as np

from gpf.scene.load import load_scene


def test_cornell_box_is_mitsubas(root):
    original = mi.load_dict(mi.cornell_box(), optimize=False)
    ours = load_scene("cornell_box", root=root)
    assert {s.id() for s in ours.shapes()} == {s.id() for s in original.shapes()}
    theirs, here = mi.traverse(original), mi.traverse(ours)
    compared = [key for key in here.keys() if key in theirs.keys()]  # noqa: SIM118
    assert {"floor.to_world", "light.emitter.radiance.value", "sensor.to_world"} <= set(compared)
    for key in compared:
        value = here[key]
        if hasattr(value, "matrix"):
            np.testing.assert_allclose(
                np.array(value.matrix), np.array(theirs[key].matrix), atol=1e-6, err_msg=key
            )
        elif not isinstance(value, mi.ScalarPoint2u | mi.ScalarVector2u):
            np.testing.assert_allclose(np.array(value), np.array(theirs[key]), atol=1e-6)
