"""Scenes that Blender made, converted, against Cycles: the light, and where it is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from gpf.blender.conversion import Converted, convert
from gpf.blender.process import find_blender
from gpf.core.errors import UserError
from gpf.core.images import tone_map
from gpf.scene.views import read_views

HERE = Path(__file__).parent


def python() -> str | None:
    """A Python with `bpy`, or None."""
    try:
        command = find_blender()
    except UserError:
        return None
    return None if "--python" in command else command[0]


PYTHON = python()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(600),
    pytest.mark.skipif(PYTHON is None, reason="no Blender: gpf blender-install"),
]


def run(script: str, *words: object) -> None:
    command = [str(PYTHON), str(HERE / script), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]


def cycles(file: Path, samples: int, seed: int) -> np.ndarray:
    out = file.with_name(f"{file.stem}_{seed}.exr")
    run("traced.py", file, out, samples, seed)
    return np.array(mi.Bitmap(str(out)), dtype=np.float64)[..., :3]


def mitsuba(made: Converted, samples: int, seed: int) -> np.ndarray:
    # Only `volpath` sees lamps through surfaces with an opacity.
    integrator = mi.load_dict({"type": "volpath", "max_depth": 32, "rr_depth": 16})
    scene = mi.load_file(str(made.xml))
    image = mi.render(scene, integrator=integrator, spp=samples, seed=seed)
    return np.array(image, dtype=np.float64)[..., :3]


@pytest.mark.parametrize(
    ("name", "samples", "decibels"),
    [
        ("lamps", 64, 40),
        ("materials", 256, 35),
        ("textures", 64, 38),
        ("baked", 64, 36),
        ("cutouts", 64, 38),
        ("copies", 64, 36),
        ("eye", 64, 40),
        ("skylight", 64, 40),
        ("pool", 256, 33),
        ("room", 96, 35),
        ("fog", 256, 35),
    ],
)
def test_a_scene_looks_as_in_cycles(tmp_path, two_threads, name, samples, decibels):
    """Energy within 2 %, and the PSNR without the noise of either."""
    run("made.py", name, tmp_path / f"{name}.blend")
    made = convert(tmp_path / f"{name}.blend", tmp_path / "out", lambda what: None)
    ours = [mitsuba(made, samples, seed) for seed in range(2)]
    theirs = [cycles(tmp_path / f"{name}.blend", samples, seed) for seed in range(2)]
    assert np.mean(ours) == pytest.approx(np.mean(theirs), rel=0.02)
    exposure = 0.5 / np.median(theirs)
    f, g, a, b = (tone_map(image, exposure) for image in (*ours, *theirs))
    error = ((f - a) * (g - b)).mean()
    # An estimate without bias: below zero where the two differ by their noise alone.
    print(name, np.mean(ours) / np.mean(theirs), f"{-10 * np.log10(max(error, 1e-7)):.1f} dB")
    assert error < 10 ** (-decibels / 10)
    expected = {"exact"} if name == "textures" else {"exact", "baked"}
    assert set(made.how.values()) <= expected


def test_a_camera_that_moves_is_a_path(tmp_path):
    run("made.py", "eye", tmp_path / "eye.blend")
    made = convert(tmp_path / "eye.blend", tmp_path / "out", lambda what: None)
    views = read_views(made.xml.parent / "views.yaml")
    frames = views.frames()
    np.testing.assert_allclose(frames[5].shift, (0.1 * 192 / 128, 0.15), rtol=1e-6)
    assert len(frames) == 24 and views.aspect == pytest.approx(128 / 192)
    assert frames[0].origin[0] == pytest.approx(0, abs=1e-5)
    assert frames[-1].origin[0] == pytest.approx(3, abs=1e-5)


def test_commands_take_a_file_of_blender(tmp_path, monkeypatch):
    """The scene is converted once; the pictures are of its own camera."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("GPF_BLENDER", str(PYTHON))
    run("made.py", "room", tmp_path / "room.blend")

    def gpf(*words: object) -> str:
        command = [sys.executable, "-m", "gpf", *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
        assert done.returncode == 0, done.stderr
        return done.stderr

    gpf("fit", "room.blend", "--passes", 6, "-o", "room.safetensors")
    (scene,) = (tmp_path / "cache" / "gpf" / "scenes").glob("room-*/scene.xml")
    made = scene.stat().st_mtime_ns
    gpf("render", "room.blend", "--field", "room.safetensors", "--size", "48x32", "-o", "pictures")
    assert scene.stat().st_mtime_ns == made
    (picture,) = (tmp_path / "pictures").glob("*.png")
    assert np.asarray(Image.open(picture)).mean() > 20


@pytest.mark.parametrize(
    ("suffix", "data", "words"),
    [
        ("blend", b"no file of Blender", "not supported|Missing"),
        ("glb", b"glTF\x02\0\0\0", "unpack|glTF|buffer"),
        ("gltf", b'{"asset":', "json"),
        ("usda", b"junk", "USD"),
        ("fbx", b"junk", "FBX"),
    ],
)
def test_files_that_blender_refuses(tmp_path, suffix, data, words):
    file = tmp_path / f"scene.{suffix}"
    file.write_bytes(data)
    with pytest.raises(UserError, match=words):
        convert(file, tmp_path / "out", lambda what: None)
    assert not (tmp_path / "out").exists()
