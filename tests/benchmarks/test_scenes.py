"""`python -m benchmarks.scenes`: a scene's cameras, and a file that Mitsuba 3 cannot read."""

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from benchmarks import scenes
from benchmarks.measured_scenes import BUILT, open_scene
from benchmarks.moving_scenes import ANIMATIONS
from benchmarks.pictures import GAP, HEAD
from benchmarks.scenes import app
from gpf.scene.frames import scene_frames
from gpf.scene.load import load_scene_file

OLD = """
<scene version="0.5.0">
    <integrator type="path"/>
    <sensor type="perspective">
        <float name="fov" value="40"/>
        <sampler type="independent"><integer name="sampleCount" value="4"/></sampler>
        <film type="hdrfilm"><integer name="width" value="16"/></film>
    </sensor>
    <shape type="sphere">
        <bsdf type="phong"><float name="exponent" value="30"/></bsdf>
    </shape>
    <shape type="obj"><string name="filename" value="lost.obj"/></shape>
    <emitter type="envmap"><string name="filename" value="lost.exr"/></emitter>
</scene>"""


@pytest.mark.slow
def test_placement(run, tmp_path, monkeypatch):
    monkeypatch.setattr(scenes, "PASSES", 2)
    run(app, "placement", "--sheet", tmp_path / "sheet.png", "open_box")
    with Image.open(tmp_path / "sheet.png") as sheet:
        views = 3 + 5 + 4
        assert sheet.size == (views * (96 + GAP) - GAP, scenes.ROWS + HEAD)
        first = np.asarray(sheet)[HEAD:, :96]
    assert 20 < first.mean() < 235 and first.std() > 5


def test_an_old_scene_is_mended(run, tmp_path):
    source = tmp_path / "clones" / "hchoi405+dppm-scenes" / "scenes" / "torus"
    source.mkdir(parents=True)
    (source / "scene.xml").write_text(OLD)
    told = run(app, "fetch", tmp_path, "torus")
    for change in ("phong becomes roughplastic", "exponent", "lost.obj is missing", "lost.exr is"):
        assert change in told
    scene = mi.load_file(str(tmp_path / "torus" / "scene.xml"))
    assert len(scene.shapes()) == 1 and scene.environment() is not None


@pytest.mark.parametrize("name", BUILT)
def test_each_scene_has_a_camera_and_a_lamp(name, two_threads):
    measured = open_scene(name)
    assert measured.aspect == pytest.approx(4 / 3) and measured.scene.emitters()
    assert measured.training_views == [measured.own]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "moving"),
    [
        ("waves", {"water-surface"}),
        ("door", {"door", "door-handle"}),
        ("lamp", {"light"}),
        ("ball", {"ball"}),
    ],
)
def test_in_an_animation_only_what_is_said_moves(name, moving, tmp_path, two_threads):
    ANIMATIONS[name].write(tmp_path, count=3)
    last = [load_scene_file(frame.file) for frame in scene_frames(tmp_path)[1:]]
    shapes = [{shape.id(): corners(shape) for shape in scene.shapes()} for scene in last]
    apart = {key for key in shapes[0] if not np.array_equal(*(each[key] for each in shapes))}
    assert apart == moving


def corners(shape: mi.Shape) -> np.ndarray:
    """What places a shape: its vertices, or the corners of its box."""
    if shape.is_mesh():
        return np.array(shape.vertex_positions_buffer())
    box = shape.bbox()
    return np.array([box.min, box.max])
