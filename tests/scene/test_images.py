"""Images that scenes name."""

from __future__ import annotations

import gc
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest

from gpf.core.errors import UserError
from gpf.photons.emission import emit_light
from gpf.scene.inventory import check_scene
from gpf.scene.load import load_scene_file

PROJECT = Path(__file__).parents[2]


WITH_ONE_THREAD = """
import sys
from pathlib import Path
import gpf
import drjit as dr
gpf.choose_variant("auto")
dr.set_thread_count(1)
scene = gpf.load_scene_file(Path(sys.argv[1]))
print(scene.environment().class_name(), dr.thread_count())
"""


def test_an_exr_file_is_read_with_one_thread(tmp_path):
    """Mitsuba alone would wait for ever."""
    pixels = np.linspace(0, 1, 6 * 8 * 3, dtype=np.float32).reshape(6, 8, 3)
    OpenEXR.File({}, {"RGB": pixels}).write(str(tmp_path / "sky.exr"))
    sky = '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>'
    (tmp_path / "scene.xml").write_text(
        f'<scene version="3.0.0">{sky}<shape type="sphere"/></scene>'
    )
    command = [sys.executable, "-c", WITH_ONE_THREAD, str(tmp_path / "scene.xml")]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["EnvironmentMapEmitter", "1"], done.stderr


SKY = """
<scene version="3.0.0">
    <sensor type="perspective"/>
    <shape type="rectangle"/>
    <emitter type="envmap">
        <string name="filename" value="sky.exr"/>
        <boolean name="mis_compensation" value="true"/>
    </emitter>
</scene>"""


def test_the_dim_parts_of_a_sky_emit_light_too(tmp_path, two_threads):
    """With ``mis_compensation``, Mitsuba samples nothing below the mean of an environment map."""
    pixels = np.full((8, 16, 3), 1.0, np.float32)
    pixels[2, 3] = 500
    mi.Bitmap(pixels).write(str(tmp_path / "sky.exr"), quality=1)
    (tmp_path / "scene.xml").write_text(SKY)
    scene = load_scene_file(tmp_path / "scene.xml")
    ray, power, _ = emit_light(scene, seeded(40_000))
    up = np.array(ray.d.y) < -0.9  # from above, where the sun is not
    found = np.array(power)[0]
    sphere = scene.bbox().bounding_sphere().radius
    expected = 2 * np.pi * 0.1 * np.pi * sphere**2  # 1 W/m²/sr from a cap of 2 π (1 - .9)
    assert (found * up).mean() == pytest.approx(expected, rel=0.1)
    raw = mi.load_file(str(tmp_path / "scene.xml"))
    with pytest.raises(UserError, match="mis_compensation, whose dim parts would emit no photons"):
        check_scene(raw)


def seeded(lanes: int) -> mi.Sampler:
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, lanes)
    return sampler


@pytest.mark.parametrize("part", ["sky.exr", "tex.exr"])
def test_images_with_pixels_that_are_no_numbers_are_named(tmp_path, two_threads, part):
    """Before the light is blamed on cameras, or ends a fit with a traceback."""
    for file in ("sky.exr", "tex.exr"):
        pixels = np.full((4, 8, 3), 0.5, np.float32)
        pixels[1, 2] = np.nan if file == part else 0.5
        mi.util.write_bitmap(str(tmp_path / file), mi.Bitmap(pixels), write_async=False)
    texture = '<texture type="bitmap" name="reflectance"><string name="filename" value="tex.exr"/>'
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><emitter type="envmap" id="sky"><string name="filename" '
        f'value="sky.exr"/></emitter><shape type="sphere"><bsdf type="diffuse" id="wood">{texture}'
        "</texture></bsdf></shape></scene>"
    )
    what = "data of sky" if part == "sky.exr" else "reflectance.data of wood"
    with pytest.raises(UserError, match=rf"scene\.xml: has NaN or infinite numbers in {what}\."):
        load_scene_file(tmp_path / "scene.xml")
    gc.collect()  # the error's traceback holds the scene
