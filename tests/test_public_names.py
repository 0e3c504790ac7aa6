"""The names that `gpf` itself has: loaded at their first use, known to type checkers."""

import ast
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
early = {name for name, module in gpf._MODULES.items() if module in sys.modules}
assert early <= {"FileError", "UserError", "choose_variant"}, early
for name in gpf.__all__:
    getattr(gpf, name)
assert mi.variant() is None, mi.variant()
from gpf import *
assert {*gpf.__all__} <= {*globals()}
"""


@pytest.mark.parametrize("name", gpf.__all__)
def test_each_name_is_that_of_its_module(name):
    home = importlib.import_module(gpf._MODULES[name])
    value = getattr(gpf, name)
    assert value is getattr(home, name)
    assert (value.__module__, name in dir(gpf)) == (home.__name__, True)


def test_names_need_no_variant_and_import_nothing_before_their_use():
    done = subprocess.run(
        [sys.executable, "-c", BEFORE_A_VARIANT], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


def test_type_checkers_see_the_same_names():
    tree = ast.parse(Path(gpf.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    seen = {name.asname: node.module for node in imports for name in node.names}
    assert ast.unparse(block.test) == "TYPE_CHECKING"
    assert seen == gpf._MODULES


def test_other_names_are_errors():
    with pytest.raises(AttributeError, match="module 'gpf' has no attribute 'Recipes'"):
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
