"""`python -m benchmarks.quality`, at sizes of no use: each command runs, and prints numbers."""

import re
from functools import partial
from pathlib import Path

import pytest
from PIL import Image

from benchmarks import fit
from benchmarks.pictures import HEAD
from benchmarks.quality import app
from examples import inverse_lighting
from gpf.rendering.denoiser import available
from tests.benchmarks.conftest import cells, numbers

SMALL = ("--rows", 16, "--reference-passes", 2)
BOX = "cornell_box"
FILE = Path(__file__).parents[2] / "scenes" / BOX / "scene.xml"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "name", "least"),
    [
        (["fit", "--passes", 2, "--views", "training", *SMALL], BOX, 8),
        (["error", "--seconds", 1, *SMALL], BOX, 2),
        (["energy", "--passes", 2, "--rows", 16, "--samples", 5], BOX, 5),
        (["energy", "--passes", 2, "--rows", 16, "--samples", 5, "one_lamp"], "one_lamp", 5),
    ],
    ids=["fit", "error", "energy by SPPM", "energy by path"],
)
def test_a_command_prints_a_line_for_a_scene(run, tmp_path, words, name, least):
    scene = [] if name in words else [name]
    told = run(app, *words, "--kept", tmp_path, *scene)
    assert len(numbers(cells(told, name))) >= least, told
    assert any(tmp_path.glob(f"*{name}*.npz"))  # the truth is kept


@pytest.mark.slow
def test_frame(run, tmp_path, monkeypatch):
    monkeypatch.setattr(fit, "SAMPLES", ((1, False),))
    told = run(app, "frame", "--seconds", 1, *SMALL, "--kept", tmp_path, BOX)
    assert len(numbers(cells(told, "1"))) == 2
    assert (tmp_path / f"{BOX}_1s.safetensors").exists()


@pytest.mark.slow
@pytest.mark.skipif(not available(), reason="needs the optional package pyoidn")
def test_rooms(run, tmp_path):
    sizes = ("--rows", 16, "--views", 3, "--judged", 2, "--samples", 5)
    told = run(app, "rooms", FILE, "--passes", 2, *sizes, "--kept", tmp_path)
    for method in ("field", "path + OIDN", "SPPM"):
        assert len(numbers(cells(told, method))) == 4
    with Image.open(tmp_path / f"{BOX}.png") as picture:
        assert picture.height == 2 * (16 + HEAD)
    assert re.search(r"2 passes in \d+ s, .*ratio \d", told, re.DOTALL)


@pytest.mark.slow
@pytest.mark.skipif(not available(), reason="needs the optional package pyoidn")
def test_noise(run):
    told = run(app, "noise", BOX, "--seconds", 1, "--rows", 16, "--spp", 16, "--samples", 16)
    lines = [line for line in told.splitlines() if re.search(r"\d\.\d{4}", line)]
    assert len(lines) == 16 and all(len(re.findall(r"[\d.]+", line)) == 4 for line in lines)


@pytest.mark.slow
def test_inverse(run, monkeypatch):
    take = partial(inverse_lighting.take_photograph, passes=8)
    monkeypatch.setattr(inverse_lighting, "take_photograph", take)
    monkeypatch.setattr(inverse_lighting, "ROUNDS", 1)
    told = run(app, "inverse", "--seconds", 1, "--rows", 16, "--spp", 2)
    for method in ("field", "prb"):
        (line,) = (line for line in told.splitlines() if f" {method}, " in line)
        assert len(re.findall(r"[\d.]+ %", line)) == 3


@pytest.mark.slow
def test_frames(run, tmp_path):
    told = run(app, "frames", "lamp", "--frames", "2:4", "--seconds", 1, *SMALL, "--kept", tmp_path)
    for method, full in (("fields", 7), ("a fit", 7), ("SPPM", 5), ("LuxCore", 5)):
        found = [line.split("│")[2:-1] for line in told.splitlines() if f"│ {method}" in line]
        assert found and all(sum(map(bool, map(str.strip, f))) == full for f in found), told


@pytest.mark.slow
def test_drift(run, tmp_path):
    """Both lines begin with the same field."""
    told = run(app, "frames", "lamp", "--frames", "2:4", "--passes", 6, *SMALL, "--kept", tmp_path)
    later, anew = (
        next(line.split("│") for line in told.splitlines() if method in line)
        for method in ("one after the other", "a first field in each")
    )
    first, second = (line[4].split(" to ") for line in (later, anew))
    assert first[0] == second[0] and first[1] != second[1], told
