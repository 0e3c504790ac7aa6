"""Errors of Mitsuba become words; other errors keep their traceback."""

import drjit as dr
import mitsuba as mi
import pytest

from gpf.core.errors import UserError
from gpf.scene.untraceable import telling_untraceable
from tests.furnace import diffuse, studio


def test_an_error_of_mitsuba_inside_a_loop_is_told():
    bumpy = {"type": "bumpmap", "bumps": {"type": "checkerboard"}, "bsdf": diffuse(0.5)}
    scene = mi.load_dict(studio(bumpy) | {"integrator": {"type": "path"}})
    words = r"room: cannot be traced: \[Texture\] .*eval_1_grad"
    with pytest.raises(UserError, match=words), telling_untraceable("room"):
        dr.eval(mi.render(scene, spp=1))


def test_an_error_of_this_program_is_not_told():
    with pytest.raises(RuntimeError, match="incompatible sizes"), telling_untraceable("room"):
        mi.Float(1, 2) + mi.Float(1, 2, 3)
