"""The scene in its baked light, as Blender wrote it, rendered by Cycles."""

from __future__ import annotations

import subprocess
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from gpf.commands.baked_scene import ROWS, write_blend
from gpf.core.images import tone_map
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from tests.baking.showroom import ASPECT, EXPOSURE, VIEWS, bake_showroom, grouped_field, showroom
from tests.baking.test_page import is_matte
from tests.blender.test_against_cycles import PYTHON, run

FINER = 6
SIZE = (round(ROWS * ASPECT) // FINER, ROWS // FINER)

DARKER = """
import bpy, sys
bpy.ops.wm.open_mainfile(filepath=sys.argv[-1])
nodes, name = bpy.data.node_groups["Baked Light"].nodes, f"Level of {sys.argv[-2]}"
node = next(node for node in nodes if node.label == name)
node.inputs["Scale"].default_value = 0.25
bpy.ops.wm.save_mainfile()
"""


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.skipif(PYTHON is None, reason="no Blender: gpf blender-install")
def test_cycles_shows_what_the_renderer_shows(tmp_path, two_threads):
    # Cycles interpolates between pixels before it makes them linear, Mitsuba afterwards.
    scene = showroom(tmp_path, finer=16)
    field = grouped_field(scene)
    baked, stage, members = bake_showroom(scene, field, 512)
    file = tmp_path / "lit.blend"
    write_blend(file, stage, baked, EXPOSURE, members)
    settings = RenderSettings(spp=64, adaptive=False, suppress_fireflies=False, denoise=False)
    renderer = FieldRenderer.make(scene, field, settings)
    matte = is_matte(scene, VIEWS[0], SIZE)
    assert matte.mean() > 0.7
    for level in (1.0, 0.25):
        renderer.integrator.lights = "" if level == 1 else f"lamp={level},sky=1"
        wanted = renderer.render(VIEWS[0], SIZE, 0)["radiance"]
        error = (tone_map(traced(file), EXPOSURE) - tone_map(wanted, EXPOSURE))[matte]
        assert -10 * np.log10(np.mean(error**2)) > 35, level
        subprocess.run([str(PYTHON), "-c", DARKER, "lamp", str(file)], check=True, timeout=200)


def traced(file: Path) -> np.ndarray:
    """Radiance, (H, W, 3)."""
    out = file.with_suffix(".exr")
    run("traced.py", file, out, 4, 0)
    fine = np.array(mi.Bitmap(str(out)), dtype=np.float64)[..., :3]
    return fine.reshape(SIZE[1], FINER, SIZE[0], FINER, 3).mean(axis=(1, 3))
