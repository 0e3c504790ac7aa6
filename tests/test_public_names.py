"""The names that `gpf` itself has: loaded at their first use."""

import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gpf
from tests.plain_field import flat_gaussians, to_device

BEFORE_A_VARIANT = """
import sys
import gpf
import mitsuba as mi
early = {"torch", "gpf.fitting.fit", "gpf.field.field"} & {*sys.modules}
assert not early, early
for name in gpf.__all__:
    getattr(gpf, name)
assert mi.variant() is None, mi.variant()
from gpf import *
assert {*gpf.__all__} <= {*globals()}
"""


@pytest.mark.parametrize("name", gpf.__all__)
def test_each_name_is_that_of_its_module(name):
    value = getattr(gpf, name)
    assert value is getattr(importlib.import_module(value.__module__), name)
    assert name in dir(gpf)


def test_names_need_no_variant_and_import_nothing_before_their_use():
    done = subprocess.run(
        [sys.executable, "-c", BEFORE_A_VARIANT], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


def test_other_names_are_errors():
    with pytest.raises(AttributeError, match="Recipes"):
        _ = gpf.Recipes


def test_files_may_be_given_as_text(tmp_path):
    folder = Path("scenes/cornell_box").resolve()
    scene = gpf.load_scene_file(str(folder / "scene.xml"))
    assert gpf.read_views(str(folder / "views.yaml")).train
    field = gpf.GaussianPhotonField(
        to_device(flat_gaussians(np.zeros((1, 3)), np.ones((1, 3)), size=1)),
        gpf.FieldSettings(search_radius=1),
        (scene.bbox().min, scene.bbox().max),
    )
    gpf.save_field(field, f"{tmp_path}/field.safetensors")
    again = gpf.load_field(f"{tmp_path}/field.safetensors")
    assert again.settings == field.settings
