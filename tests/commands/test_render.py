"""`gpf render`: pictures, what is kept, cameras, and fields of other scenes."""

from __future__ import annotations

import gc
import io
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from imageio_ffmpeg import get_ffmpeg_exe
from PIL import Image

from gpf.commands.workers import SentScenes
from gpf.core.images import read_exr
from gpf.core.structs import from_numpy
from gpf.field.gaussians import Gaussians
from gpf.field.io import load_field, save_field
from gpf.rendering.aovs import expected_psnr
from gpf.rendering.field_renderer import WEAK_COVERAGE
from gpf.scene.frames import SceneFrame
from gpf.scene.transforms import read_transforms
from gpf.scene.views import read_views
from tests.commands.box import SOURCE
from tests.commands.rendering import CHEAP, refused, render, run


def test_without_options_the_scenes_own_camera(box, capsys):
    render()
    files = sorted(path.name for path in (box / "pictures").iterdir())
    assert files == ["sensor.exr", "sensor.png", "transforms.json"]
    layers, record = read_exr(box / "pictures" / "sensor.exr")
    assert layers["radiance"].shape == (16, 20, 3) and record["render"]["spp"] == 4
    with Image.open(box / "pictures" / "sensor.png") as picture:
        assert picture.size == (20, 16) and np.asarray(picture).mean() > 20
    assert "pictures: 1 picture, " in capsys.readouterr().err


def test_places_that_the_field_does_not_know_are_said(box, capsys):
    render("-o", "a")
    assert "weakly covered" not in capsys.readouterr().err
    field = load_field(box / "field.safetensors")
    known = from_numpy(mi.UInt32, np.flatnonzero(field.gaussians.means.y.numpy() > -0.7))
    parts = vars(field.gaussians).items()
    field.update(Gaussians(**{name: dr.gather(type(v), v, known) for name, v in parts}))
    save_field(field, box / "without_floor.safetensors")
    render("--field", "without_floor.safetensors", "-o", "b")
    layers, record = read_exr(box / "b" / "sensor.exr")
    assert "coverage" not in layers and 0.03 < record["weakly_covered"] < 0.5
    assert f"{record['weakly_covered']:.2%} of the pixels are weakly" in capsys.readouterr().err
    render("--field", "without_floor.safetensors", "-o", "c", "--aovs", "coverage")
    layers, again = read_exr(box / "c" / "sensor.exr")
    assert (layers["coverage"] > WEAK_COVERAGE).mean() == again["weakly_covered"]


def test_pictures_that_exist_are_kept(box, capsys):
    render("--orbit", "3", "-o", "a")
    files = {path: path.stat().st_mtime_ns for path in (box / "a").glob("*.exr")}
    assert len(files) == 3
    (box / "a" / "orbit_001.exr").unlink()
    (box / "a" / "orbit_002.png").unlink()
    capsys.readouterr()
    render("--orbit", "3", "-o", "a")
    assert "2 pictures, " in (said := capsys.readouterr().err) and "1 already done" in said
    assert (box / "a" / "orbit_000.exr").stat().st_mtime_ns == files[box / "a" / "orbit_000.exr"]


def test_pictures_made_in_another_way_are_replaced_if_asked(box, capsys):
    render("-o", "a")
    before = (box / "a" / "sensor.exr").read_bytes()
    for changed in (("--seed", "1"), ("--exposure", "2"), ("--aovs", "depth"), ("--spp", "2")):
        said = refused(capsys, "-o", "a", *changed)
        assert "a/sensor.exr: already exists. Add --overwrite" in said, changed
        assert (box / "a" / "sensor.exr").read_bytes() == before
        render("-o", "a", "--overwrite", *changed)
        assert "1 picture, " in capsys.readouterr().err, changed
        before = (box / "a" / "sensor.exr").read_bytes()


def test_a_picture_does_not_depend_on_those_beside_it(box):
    render("--orbit", "4", "-o", "four")
    render("--views", "four/transforms.json", "--view", "orbit_002", "-o", "one")
    # The camera went through a file with rounded angles: equal rays, but for the last digits.
    four, one = (read_exr(box / f / "orbit_002.exr")[0]["radiance"] for f in ("four", "one"))
    assert np.median(np.abs(one - four)) < 1e-3


def test_an_orbit_goes_around_what_the_camera_sees(box):
    """The box is open to one side only: the cameras stay on that side."""
    render("--orbit", "6", "--size", "8", "-o", "a")
    views = read_transforms(box / "a" / "transforms.json").train
    assert [view.name for view in views] == [f"orbit_{k:03d}" for k in range(6)]
    places = np.array([view.origin for view in views])
    assert len(np.unique(places.round(3), axis=0)) == 6
    for file in (box / "a").glob("*.exr"):
        assert (read_exr(file)[0]["radiance"] > 0).all(-1).mean() > 0.8, file


def test_a_film_of_all_pictures(box):
    render("--orbit", "4", "--mp4", "-o", "a")
    command = [get_ffmpeg_exe(), "-loglevel", "error", "-i", "a/film.mp4", "-f", "rawvideo"]
    raw = subprocess.run([*command, "-pix_fmt", "rgb24", "-"], capture_output=True, check=True)
    shown = np.frombuffer(raw.stdout, np.uint8).reshape(4, 16, 20, 3)
    with Image.open("a/orbit_002.png") as picture:
        assert np.abs(shown[2].astype(int) - np.asarray(picture)).mean() < 12


def test_a_time_in_place_of_a_number_of_samples(box):
    assert run("--size", "20x16", "--seconds", "0.3") == 0
    layers, record = read_exr(box / "pictures" / "sensor.exr")
    assert record["seconds"] == 0.3 and np.isfinite(layers["radiance"]).all()


@pytest.mark.parametrize("part", ["materials", "lights", "geometry"])
def test_what_has_changed_since_the_fit_is_named(box, capsys, part):
    change(box / "box.xml", part)
    said = refused(capsys)
    assert "field.safetensors: was fitted to another scene, or before box.xml was changed" in said
    assert f"different {part}." in said and "--changed-scene" in said
    assert not (box / "pictures").exists()
    render("--changed-scene")
    assert (box / "pictures" / "sensor.png").exists()


def change(file: Path, part: str) -> None:
    """Change one part of the Cornell Box."""
    text = file.read_text(encoding="utf-8")
    if part == "lights":
        new = text.replace("18.387, 13.9873, 6.75357", "8.387, 13.9873, 6.75357")
    elif part == "materials":
        new = text.replace("0.105421, 0.37798, 0.076425", "0.4, 0.37798, 0.076425")
    else:
        new = text.replace('<scale value="0.3"/>', '<scale value="0.29"/>')
    assert new != text
    file.write_text(new, encoding="utf-8")


def test_fields_that_do_not_know_their_scene_are_taken(box):
    field = load_field(box / "field.safetensors")
    field.record = {}
    save_field(field, box / "field.safetensors")
    change(box / "box.xml", "lights")
    render()
    assert (box / "pictures" / "sensor.png").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--size", "wide"), "--size wide: is not a size. Give WIDTHxHEIGHT"),
        (("--aovs", "dept"), "--aovs dept: unknown name 'dept'. Choose from depth"),
        (("--aovs", "error"), "field.safetensors: has no error estimate. Fit it with `gpf fit`"),
        (("--view", "sensr"), "view 'sensr': does not exist. Did you mean 'sensor'?"),
        (("--cluster", "head:10001"), "--cluster: needs `--executor ray`"),
        (("--frames", "all"), "box.xml: has no camera path"),
        (("--seconds", "nan"), "--seconds: is nan. Give a number above 0"),
        (("--seconds", "-1"), "--seconds: is -1.0. Give a number above 0"),
        (("--exposure", "inf"), "--exposure: is inf. Give a number above 0"),
        (("--orbit", "3", "--view", "sensor"), "--orbit and --view: are mutually"),
        (("--field", "none.safetensors"), "none.safetensors: does not exist"),
        (("--views", "none.json"), "none.json: does not exist"),
        (("--orbit", "1000000000"), "less than or equal to"),
        (("--spp", "10000000000"), "less than or equal to"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(box, capsys, words, says):
    assert says in refused(capsys, *words)
    assert not (box / "pictures").exists()


def test_the_expected_error_is_said_and_kept_with_the_picture(box, capsys):
    field = load_field(box / "field.safetensors")
    field.set_error(np.full(len(field.gaussians.means.numpy().T), 0.02, np.float32))
    save_field(field, box / "field.safetensors")
    render("--aovs", "error")
    layers, record = read_exr(box / "pictures" / "sensor.exr")
    assert record["expected_psnr"] == pytest.approx(
        expected_psnr(layers["radiance"], layers["error"], 1.5), abs=0.01
    )
    assert f"light accurate to {record['expected_psnr']:.1f} dB" in capsys.readouterr().err


def test_views_beside_the_scene(box):
    shutil.copyfile(SOURCE / "views.yaml", box / "views.yaml")
    render("--view", "front", "-o", "a")
    assert [path.name for path in (box / "a").glob("*.png")] == ["front.png"]
    shutil.copyfile(SOURCE / "views.yaml", box / "other.yaml")
    for folder, words in (("beside", ()), ("named", ("--views", "other.yaml"))):
        render(*words, "-o", folder)  # those that no method trains with, or all without any
        found = {path.stem for path in (box / folder).glob("*.png")}
        assert found == {view.name for view in read_views("views.yaml").novel}


def test_what_the_scenes_camera_has_and_views_do_not_is_said(box, capsys):
    text = (box / "box.xml").read_text(encoding="utf-8")
    lens = '<sensor type="thinlens" id="sensor"><float name="aperture_radius" value="0.1"/>'
    crop = '<film type="hdrfilm"><integer name="crop_width" value="9"/>'
    for old, new in ((r"<sensor .*>", lens), (r"<film .*>", crop)):
        text, count = re.subn(old, new, text)
        assert count == 1
    (box / "box.xml").write_text(text, encoding="utf-8")
    render()
    said = capsys.readouterr().err
    assert "sensor sensor has an aperture: views are in focus everywhere" in said
    assert "sensor sensor shows a crop of its film: views show the whole film" in said
    shutil.copyfile(SOURCE / "views.yaml", box / "views.yaml")
    render("--view", "front")
    assert "aperture" not in capsys.readouterr().err


def test_what_travels_to_a_cluster_is_the_scene_and_its_files(tmp_path):
    scene, mesh = tmp_path / "a" / "scene.xml", tmp_path / "b" / "mesh.ply"
    for file in (scene, mesh):
        file.parent.mkdir()
    mesh.write_bytes(b"ply")
    os.utime(mesh, (0, 0))  # as on systems that give no dates
    shape = '<shape type="ply"><string name="filename" value="../b/mesh.ply"/></shape>'
    scene.write_text(f'<scene version="3.0.0">{shape}</scene>')
    sent = SentScenes.pack([SceneFrame("", scene)])
    assert (sent.root, str(sent.frames[0].file)) == (tmp_path, "a/scene.xml")
    assert zipfile.ZipFile(io.BytesIO(sent.archive)).namelist() == ["a/scene.xml", "b/mesh.ply"]


def test_without_ray_the_executor_is_refused(box, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert "--executor: is ray, but the ray package is not installed" in refused(
        capsys, "--executor", "ray"
    )


@pytest.mark.slow
def test_a_cluster_gives_the_bits_of_one_machine(box, capsys):
    pytest.importorskip("ray")
    render("--orbit", "3", "-o", "here")
    program = "from gpf.cli import main; main()"
    words = ("render", "box.xml", *CHEAP, "--orbit", "3", "-o", "there", "--executor", "ray")
    subprocess.run([sys.executable, "-c", program, *words], check=True, timeout=200)
    for file in sorted((box / "here").glob("*.exr")):
        here, there = (read_exr(box / f / file.name)[0]["radiance"] for f in ("here", "there"))
        np.testing.assert_array_equal(here, there)


def test_a_material_that_cannot_be_traced_is_told(box, capsys):
    text = (box / "box.xml").read_text(encoding="utf-8")
    bump = '<bsdf type="bumpmap"><texture type="checkerboard"/><bsdf type="diffuse"/></bsdf>'
    new = text.replace("</scene>", f'<shape type="sphere">{bump}</shape></scene>')
    (box / "box.xml").write_text(new, encoding="utf-8")
    said = refused(capsys, "--changed-scene")
    assert "box.xml: cannot be traced" in said and "Give the bumpmap a bitmap" in said
    gc.collect()  # the error's traceback holds the scene, and Dr.Jit traces through all that exist
