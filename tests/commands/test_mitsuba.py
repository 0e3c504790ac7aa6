"""`gpf mitsuba scene.xml` renders, or says in words why not, and leaves no half of a file."""

from __future__ import annotations

import gc
import os
import re
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import gpf.commands.mitsuba as command
from gpf.cli import main

PROJECT = Path(__file__).parents[2]

SCENE = """\
<scene version="3.0.0">
    <default name="kind" value="path"/>
    <integrator type="$kind"/>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="1,0,4" target="1,0,0" up="0,1,0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="8"/><integer name="height" value="6"/>
            <rfilter type="box"/> <!-- others add up pixels in the order of threads -->
        </film>
    </sensor>
    <shape type="sphere"><emitter type="area"/></shape>
</scene>
"""
SPPM = '<integrator type="sppm"><integer name="passes" value="0"/></integrator>'
AOV = '<integrator type="aov"><string name="aovs" value="d:depth,n:sh_normal"/></integrator>'
NO_TRIANGLES = """<shape type="obj" id="none"><string name="filename" value="none.obj"/>
<boolean name="face_normals" value="true"/></shape></scene>"""
BUMPY = """<bsdf type="bumpmap"><texture type="checkerboard"/>
<bsdf type="diffuse"/></bsdf><emitter type"""


class Stopped(mi.SamplingIntegrator):
    """Ctrl-C arrives in a loop of Dr.Jit."""

    def render(self, *arguments, **options):
        def stop(i):
            raise KeyboardInterrupt

        dr.while_loop((mi.UInt32(0),), lambda i: i < 2, stop)


mi.register_integrator("stopped", Stopped)


@pytest.fixture
def room(tmp_path, monkeypatch, two_threads) -> Iterator[Path]:
    gc.collect()  # what is left of a scene would be traced with the next
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.xml").write_text(SCENE)
    (tmp_path / "none.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    yield tmp_path


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as outcome:
        main(["mitsuba", "room.xml", *words])
    return outcome.value.code


def test_an_image_that_exists_is_not_replaced(room, capfd):
    Path("room.exr").write_text("mine")
    assert "room.exr: already exists. Add --overwrite" in refused(capfd)
    assert run("--overwrite", "--spp", "1") == 0
    assert mi.Bitmap("room.exr").channel_count() >= 3


def refused(capfd, *words: str) -> str:
    """What is said; no file is new."""
    before = {path: path.read_bytes() for path in Path().iterdir() if path.is_file()}
    assert run(*words) == 2
    assert {path: path.read_bytes() for path in Path().iterdir() if path.is_file()} == before
    text = " ".join(capfd.readouterr().err.split())
    assert "Traceback" not in text
    return text


def test_a_scene_of_the_pipeline_gives_an_image_here(room):
    made = room / "results" / "box" / "scene"
    made.mkdir(parents=True)
    (room / "room.xml").rename(made / "scene.xml")
    with pytest.raises(SystemExit) as outcome:
        main(["mitsuba", "box", "--spp", "1"])
    assert outcome.value.code == 0
    assert (room / "box.exr").is_file() and [*made.iterdir()] == [made / "scene.xml"]


@pytest.mark.parametrize("name", ["a.exr", "a.hdr", "a.pfm", "a.png", "a.JPG", "new/a.jpeg"])
def test_the_ending_chooses_the_format(room, name):
    assert run("-o", name) == 0
    assert [*mi.Bitmap(str(room / name)).size()] == [8, 6]
    assert not [*room.rglob(".*")]


def test_the_image_is_that_of_mitsuba(room):
    assert run("-o", "a.exr", "--spp", "3", "--seed", str(2**32 - 1)) == 0
    scene = mi.load_string(SCENE)
    wanted = scene.integrator().render(scene, scene.sensors()[0], seed=2**32 - 1, spp=3)
    np.testing.assert_array_equal(np.array(mi.Bitmap("a.exr")), wanted.numpy())


def test_scenes_that_photon_mapping_cannot_render(room):
    (room / "room.xml").write_text(SCENE.replace('<emitter type="area"/>', ""))
    assert run() == 0


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('<integrator type="$kind"/>', SPPM, r'does not load: At \S*room\.xml .*"passes" is 0; '),
        (SCENE, '<shape version="3.0.0" type="sphere"/>', "describes a Shape. Its outermost tag"),
        (
            "</scene>",
            NO_TRIANGLES,
            r"refers to \S*none.obj, which has no triangles. Remove the shape",
        ),
        ('<integrator type="$kind"/>', "", "lacks an integrator"),
        ('value="8"', 'value="4000000000"', "film: is 4000000000x6, which needs .* GiB"),
        ("path", "gpf", "cannot be rendered: The gpf integrator has no field"),
        ("<emitter type", BUMPY, "cannot be rendered: .Texture. .*eval_1_grad"),
    ],
)
def test_scenes_that_cannot_be_rendered(room, capfd, old, new, words):
    assert old in SCENE
    (room / "room.xml").write_text(SCENE.replace(old, new))
    assert (told := re.search(f"error: room.xml.*{words}", refused(capfd)))
    assert ".py" not in told.string and ".cpp" not in told.string


def test_an_error_in_a_loop_of_drjit(room, capfd):
    (room / "room.xml").write_text(SCENE.replace("<emitter type", BUMPY))
    assert "eval_1_grad" in refused(capfd, "-D", "kind=sppm")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--spp -1", "Invalid value for '--spp'"),
        ("--spp 4294967296", "Invalid value for '--spp'"),
        ("--seed -1", "Invalid value for '--seed'"),
        ("--seed 4294967296", "Invalid value for '--seed'"),
        ("-s 1", "-s 1: the scene has 1 sensors"),
        ("-D config=1", "-D config=1: has a name that Mitsuba reserves"),
        ("-o a.tga", "error: a.tga: is not the name of an image. Use the ending .exr, "),
        ("-o a", "error: a: is not the name of an image"),
        ("-o folder.exr", "error: folder.exr: is a folder"),
        ("-o room.xml/a.exr", "could not be written"),
    ],
)
def test_a_wrong_option_is_told_in_words(room, capfd, words, told):
    (room / "folder.exr").mkdir()
    assert told in refused(capfd, *words.split())


def test_a_format_that_cannot_hold_the_image_is_told_before_rendering(room, capfd, monkeypatch):
    (room / "room.xml").write_text(SCENE.replace('<integrator type="$kind"/>', AOV))
    monkeypatch.setattr(mi.Integrator, "render", None)
    assert "error: a.png: cannot hold the image (" in refused(capfd, "-o", "a.png")


def test_a_full_disk_leaves_the_old_image(room, capfd):
    (room / "a.exr").write_bytes(b"old")
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (600, limit[1]))
    try:
        assert "error: a.exr: could not be written" in refused(capfd, "-o", "a.exr", "--overwrite")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)


def test_an_error_of_the_file_system_is_explained(room, capfd, monkeypatch):
    def fail(*arguments):
        raise PermissionError(13, "Permission denied", "a.exr")

    monkeypatch.setattr(command, "remove_leftovers", fail)
    assert "error: a.exr: could not be written" in refused(capfd, "-o", "a.exr", "--overwrite")


def test_an_interrupt_in_a_loop_of_drjit(room, capfd):
    assert run("-D", "kind=stopped") == 130
    said = capfd.readouterr().err
    assert "stopped" in said and "cannot be rendered" not in said


def test_as_a_module(room):
    (room / "room.xml").write_text(SCENE.replace('<integrator type="$kind"/>', SPPM))
    done = subprocess.run(
        [sys.executable, "-m", "gpf", "mitsuba", "room.xml"],
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert done.stderr.startswith("error: room.xml: does not load: ")
