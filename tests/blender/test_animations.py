"""Animations that Blender made: the scene of each frame, and what frames share."""

from __future__ import annotations

import json
import re
from itertools import pairwise

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from gpf.blender.conversion import convert
from gpf.core.images import undo_tone_map
from gpf.scene.load import load_scene_file
from gpf.scene.motion import Motion
from gpf.scene.sensors import views_of_sensors
from tests.blender.test_against_cycles import PYTHON, run
from tests.commands.test_fit_frames import run as gpf
from tests.small_fit import make_small

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(600),
    pytest.mark.skipif(PYTHON is None, reason="no Blender: gpf blender-install"),
]
NUMBERS = (1, 3, 5, 7, 9)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("animated") / "pool.blend"
    run("animated.py", path, 1)
    return path


@pytest.fixture(scope="module")
def made(file):
    return convert(file, file.with_name("frames"), lambda what: None, "all")


def uses(xml, kind: str) -> list[str]:
    """The files of a kind that a scene uses, in order."""
    return re.findall(rf'value="([^"]*\.{kind})"', xml.read_text())


def test_what_is_the_same_is_written_once(made):
    assert made.numbers == NUMBERS
    assert made.files() == [frame.file for frame in made.frames()]
    assert made.notes == ("BézierCircle: baked 2 times, as its materials or its faces change",)
    meshes, images = ([uses(xml, kind) for xml in made.files()] for kind in ("ply", "png"))
    floor, still = zip(*(own[:2] for own in meshes), strict=True)
    assert len(set(floor)) == len(set(still)) == 1
    assert len({own[-3] for own in meshes}) == len(NUMBERS)  # the sheet
    assert {len(own) for own in images} == {4}
    assert images[0] == images[1] == images[2] == images[3] != images[4]
    assert len([*made.folder.glob("meshes/*")]) == len({name for own in meshes for name in own})
    assert {path.stem[-4:] for path in made.folder.glob("textures/*")} == {"0001", "0009"}


def test_what_is_baked_is_as_it_is_rendered(made):
    """With its modifiers' levels for rendering, and images with their factors."""
    xml = made.files()[0]
    sheet = (made.folder / uses(xml, "ply")[-3]).read_bytes()
    assert b"element face 12800\n" in sheet
    (file,) = re.findall(r'"material_still".*?"base_color">.*?value="(.*?)"', xml.read_text(), re.S)
    pixels = undo_tone_map(np.asarray(Image.open(made.folder / file)) / 255)
    most = pixels.max(axis=(0, 1))
    np.testing.assert_allclose(most / most[2], (0.5, 0.25, 1), atol=0.01)


def test_surfaces_have_counterparts_in_the_next_frame(made):
    scenes = [load_scene_file(xml) for xml in made.files()]
    lost = [Motion(*pair).lost for pair in pairwise(scenes)]
    assert lost == [[], [], ["Cube_001"], []]  # it is hidden from frame 7 on
    places = [views_of_sensors(scene)[0].origin for scene in scenes]
    x = [place[0] for place in places]
    assert x[0] == pytest.approx(0, abs=1e-5) and x[4] == pytest.approx(1)
    assert all(np.diff(x) > 0)


def test_a_frame_is_as_the_scene_there(made, tmp_path, two_threads):
    run("animated.py", tmp_path / "pool.blend", 7)
    alone = convert(tmp_path / "pool.blend", tmp_path / "alone", lambda what: None).xml
    frame = made.folder / "frame_0007.xml"
    text, other = (re.sub(r"(meshes|textures)/\w+", "", xml.read_text()) for xml in (frame, alone))
    assert text == other
    integrator = mi.load_dict({"type": "path", "max_depth": 4})
    image, expected = (
        np.array(mi.render(mi.load_file(str(xml)), integrator=integrator, spp=16))
        for xml in (frame, alone)
    )
    # Some faces of the spikes are cut along the other diagonal, as in the frames before.
    assert np.abs(image - expected).mean() < 5e-3 * expected.mean()


def test_the_frames_of_other_formats_are_those_of_their_actions(tmp_path):
    run("animated.py", tmp_path / "pool.glb", 1)
    made = convert(tmp_path / "pool.glb", tmp_path / "frames", lambda what: None, "7:")
    assert made.numbers == tuple(range(1, 10))
    assert [xml.name for xml in made.files()] == ["frame_0008.xml", "frame_0009.xml"]


def test_fields_and_pictures_of_an_animation(file, tmp_path, monkeypatch, capsys):
    """With a folder of fields, frames are those of the animation, else of the camera path."""
    make_small(monkeypatch, passes=30, steps=60, paths=5_000)
    monkeypatch.setattr("gpf.commands.fit_frames.ROWS", 32)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("GPF_BLENDER", str(PYTHON))
    monkeypatch.chdir(tmp_path)
    assert gpf(file, "--frames", "2:4", "--passes", "6", "-o", "fields") == 0
    fields = sorted(path.name for path in (tmp_path / "fields").glob("*.safetensors"))
    assert fields == ["frame_0005.safetensors", "frame_0007.safetensors"]
    cheap = "--frames", "2:4", "--size", "48x32", "--spp", "2"
    assert gpf(file, "--field", "fields", *cheap, "-o", "film", command="render") == 0
    told = json.loads((tmp_path / "film" / "transforms.json").read_text())["frames"]
    assert [frame["file_path"] for frame in told] == ["frame_0005.png", "frame_0007.png"]
    assert [frame["time"] for frame in told] == [0.5, 0.75]
    one = "--field", f"fields/{fields[0]}", "--changed-scene"
    assert gpf(file, *one, *cheap, "-o", "path", command="render") == 0
    capsys.readouterr()
    assert gpf(file, "--frames", "4:5", "--passes", "6", "-o", "fields") == 0
    assert "begins anew" not in capsys.readouterr().err
    assert gpf(file, "--frames", "all", "--passes", "6", "-o", "fields") == 0
    assert "3 of 5 frames are done" in capsys.readouterr().err
    assert gpf(file, "--frames", "2:99", "-o", "fields") == 2
    assert "--frames 2:99: does not name frames" in " ".join(capsys.readouterr().err.split())
    told = json.loads((tmp_path / "path" / "transforms.json").read_text())["frames"]
    assert len(told) == 2 and not any("time" in frame for frame in told)
