"""The scripts and the notebook in examples/, at small sizes. All are in one file, so that they run
in one process and share compiled kernels."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs
from PIL import Image
from scipy.optimize import minimize

import gpf
from examples import (
    animation,
    data_set,
    inverse_caustics,
    inverse_lighting,
    moving_caustics,
    own_integrator,
    own_scene,
)
from gpf.cli import main as gpf_command
from gpf.core.images import tone_map
from tests.commands.box import box_field
from tests.small_fit import make_small

PROJECT = Path(__file__).parents[2]
EXAMPLES = PROJECT / "examples"
TOUR = EXAMPLES / "tour.ipynb"
# They compile many kernels, and write EXR files.
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("two_threads")]
SCRIPTS = sorted(path.stem for path in EXAMPLES.glob("*.py"))
FEWER = {
    "animation": ["--frames", "4"],
    "moving_caustics": ["--frames", "2"],
    "inverse_lighting": ["--passes", "20"],
}
"""Options with which examples take less time."""


@pytest.fixture
def small(monkeypatch):
    """The first complete field of a fit, from few photons and steps."""
    make_small(monkeypatch, passes=16, steps=40, paths=20_000)
    monkeypatch.setattr("gpf.placement.cameras.ROWS", 32)
    monkeypatch.setattr("gpf.guiding.emission_plan.BATCH", 20_000)


@pytest.fixture
def even(monkeypatch):
    """No fit: E = 1 everywhere."""
    monkeypatch.setattr(gpf, "fit", lambda scene, *_, **goals: box_field(scene))


@pytest.fixture
def one_process(monkeypatch):
    """What a script starts as `python -m gpf.cli` runs in this process, where it is compiled."""

    start = subprocess.run

    def run(command, check=False, **options):
        if command[1:3] != ["-m", "gpf.cli"]:  # a film's encoder
            return start(command, check=check, **options)
        assert check
        with pytest.raises(SystemExit) as ended:
            gpf_command([str(word) for word in command[3:]])
        assert not ended.value.code

    monkeypatch.setattr(subprocess, "run", run)


def read(path: Path) -> np.ndarray:
    """A picture, (H, W, 3), from 0 to 1."""
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")) / 255


def psnr(one: np.ndarray, other: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean(np.square(one - other))))


def test_own_scene(tmp_path, small):
    folder = tmp_path / "new"
    own_scene.main(folder, seconds=1, size=32)
    field = gpf.load_field(folder / "field.safetensors")
    assert dr.width(field.gaussians.means) > 500 and field.record["passes"] == 16
    shown = read(folder / "own_scene.png")
    linear = np.array(mi.Bitmap(str(folder / "own_scene.exr")))[..., :3]
    assert linear.shape == shown.shape == (32, 48, 3)
    assert np.abs(tone_map(linear, 1) - shown).max() < 0.01
    # Few paths find the caustics, but the median over the picture does not see this.
    path = mi.load_dict({"type": "path"})
    truth = mi.render(own_scene.make_scene(32), integrator=path, spp=128).numpy()[..., :3]
    assert np.median(np.abs(tone_map(truth, 1) - shown)) < 0.03
    red, green, _ = shown[24:27, 22:26].mean(axis=(0, 1))  # the light behind the red ball
    assert red > 1.5 * green


def test_own_integrator(tmp_path, small):
    own_integrator.main(tmp_path, seconds=1, size=24)
    ours, path = np.split(read(tmp_path / "own_integrator.png"), 2, axis=1)
    assert ours.shape == (24, 24, 3)
    assert psnr(ours, path) > 33
    assert ours.mean() == pytest.approx(path.mean(), rel=0.01)


def test_an_animation_is_a_film_and_a_sheet_of_frames(tmp_path, even):
    animation.main(tmp_path, seconds=1, size=20, frames=6)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["animation.mp4", "animation.png"]
    count, seconds = count_frames_and_secs(str(tmp_path / "animation.mp4"))
    assert count == 6 and seconds == pytest.approx(6 / 24)


def test_an_animation_without_the_encoder(tmp_path, even, monkeypatch):
    def missing(*_):
        raise gpf.UserError("imageio_ffmpeg", "is not installed", "pip install imageio-ffmpeg")

    monkeypatch.setattr("gpf.core.films.find_encoder", missing)
    animation.main(tmp_path, seconds=1, size=20, frames=4)
    frames = [read(tmp_path / f"frame_{k:03d}.png") for k in range(4)]
    sheet = np.vstack([np.hstack(frames[:2]), np.hstack(frames[2:])])
    np.testing.assert_array_equal(read(tmp_path / "animation.png"), sheet)
    assert len(list(tmp_path.iterdir())) == 5
    turned = [psnr(one, other) for one, other in pairwise(frames)]
    assert max(turned) < 30  # the camera moves


def test_inverse_lighting(tmp_path, small):
    photograph = inverse_lighting.take_photograph(32, inverse_lighting.TRUTH, passes=30)
    *_, (found, _) = inverse_lighting.search(photograph, 1)
    for name, value in inverse_lighting.TRUTH.items():
        assert found[name] == pytest.approx(value, rel=0.15)
        assert inverse_lighting.GUESS[name] != pytest.approx(value, rel=0.5)


def test_data_set(tmp_path, even, one_process, capsys):
    data_set.main(tmp_path, seconds=1, size=80)
    assert "% of the points are seen by both views" in capsys.readouterr().err
    frame, other, third = (data_set.Frame(tmp_path / "data_set", k) for k in range(3))
    for view in (third, other):  # the third sees a wall from behind, where it is black
        colour, normal, seen = view.look_up(frame.points())
        assert seen.mean() > 0.3
        assert np.abs(colour - frame.picture)[seen].mean() < 0.02
        assert np.abs(normal - frame.normal)[seen].mean() < 0.02
    warped, picture = np.split(read(tmp_path / "data_set.png"), 2, axis=1)
    np.testing.assert_array_equal(picture, frame.picture)
    np.testing.assert_allclose(warped[seen], colour[seen], atol=0.003)
    other.pose[:3, 3] += 0.1  # a camera at a wrong place would be noticed
    _, _, seen = other.look_up(frame.points())
    assert seen.mean() < 0.1


def test_moving_caustics(tmp_path, small, one_process):
    moving_caustics.main(tmp_path, seconds=1, size=24, frames=2)
    sheet = read(tmp_path / "moving_caustics.png").reshape(4, 24, 2, 24, 3)
    sun, sky, depth, _ = sheet
    assert sun.mean() > 1.5 * sky.mean()
    assert (depth > 0.1).all()  # the bay has no holes
    for name in ("sun", "sky"):
        (first, last) = json.loads((tmp_path / name / "transforms.json").read_text())["frames"]
        assert (first["time"], last["time"]) == (0, 1)
        assert first["transform_matrix"] != last["transform_matrix"]
        count, _ = count_frames_and_secs(str(tmp_path / name / "film.mp4"))
        assert count == 2


def test_inverse_caustics(tmp_path, monkeypatch, capsys):
    searched = []
    monkeypatch.setattr(
        inverse_caustics,
        "search",
        lambda problem, seconds: searched.append(search_in_steps(problem, 20)) or searched[0],
    )
    inverse_caustics.main(tmp_path, seconds=1, size=48)
    told = re.findall(r"(\w+) lens, (\w+): correlation (\S+), PSNR", capsys.readouterr().err)
    same = {(lens, judge): float(number) for lens, judge, number in told}
    assert same["flat", "ptracer"] < 0.3 and same["flat", "sppm"] < 0.3
    assert same["found", "ptracer"] > 0.85 and same["found", "sppm"] > 0.85
    panels = {path.stem: read(path)[..., 1] for path in tmp_path.glob("*.png")}
    sheet = [
        np.hstack([panels[a], panels[b]]) for a, b in (("picture", "flat"), ("found", "heights"))
    ]
    np.testing.assert_array_equal(panels["inverse_caustics"], np.vstack(sheet))
    assert np.corrcoef(panels["picture"].ravel(), panels["found"].ravel())[0, 1] > 0.85
    lens = mi.load_dict({"type": "ply", "filename": str(tmp_path / "lens.ply")})
    assert lens.vertex_count() == 49**2 and lens.face_count() == 2 * 48**2
    depth = lens.bbox().max.z - lens.bbox().min.z
    assert depth == pytest.approx(np.ptp(searched[0]), rel=1e-4)


def search_in_steps(problem, steps: int) -> np.ndarray:
    """As `search`, with a number of steps for each σ, which no machine's speed changes."""
    modes, losses = np.zeros(problem.n**2), []
    for seed, sigma in enumerate(inverse_caustics.SIGMAS):
        flat = problem.loss(0 * modes, sigma, seed)[0]
        options = {"maxiter": steps, "maxcor": 20}
        found = minimize(problem.loss, modes, (sigma, seed), "L-BFGS-B", jac=True, options=options)
        modes = found.x
        losses.append(found.fun / flat)
    assert max(losses) < 0.2 and losses[0] < 0.01
    return problem.heights(modes)


@pytest.mark.parametrize("sigma", inverse_caustics.SIGMAS)
def test_the_derivative_of_a_caustic(sigma):
    """With respect to modes of the lens, against finite differences with the same photons."""
    problem = inverse_caustics.InverseCaustic(inverse_caustics.draw_picture(48))
    modes = 0.03 * np.random.default_rng(1).standard_normal(problem.n**2)
    _, gradient = problem.loss(modes, sigma, seed=2)
    chosen = [*np.argsort(-np.abs(gradient))[:4], 30, 31, 200, 444]
    found = []
    for k in chosen:
        step = 0.003 * (np.arange(problem.n**2) == k)
        more, less = (problem.loss(modes + change, sigma, 2)[0] for change in (step, -step))
        found.append((more - less) / 0.006)
    error = np.linalg.norm(found - gradient[chosen])
    assert error < 0.003 * np.linalg.norm(gradient[chosen])


def cells(kind: str) -> list[dict[str, Any]]:
    """The cells of the notebook that are of a kind."""
    content = json.loads(TOUR.read_text(encoding="utf-8"))
    assert (content["nbformat"], content["nbformat_minor"]) == (4, 5)
    return [cell for cell in content["cells"] if cell["cell_type"] == kind]


def run_cell(source: str, names: dict[str, Any]) -> Any:
    """Run a cell; the value of its last line, if that is an expression."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, str(TOUR), "exec"), names)
    return eval(compile(ast.Expression(last.value), str(TOUR), "eval"), names) if last else None


def test_the_tour(small, monkeypatch, capsys):
    monkeypatch.syspath_prepend(EXAMPLES)
    names: dict[str, Any] = {}
    pictures = []
    for cell in cells("code"):
        shown = run_cell("".join(cell["source"]), names)
        if "parameters" in cell["metadata"].get("tags", ()):
            names |= {"SECONDS": 1, "SIZE": 32, "PASSES": 16}
        if isinstance(shown, Image.Image):
            pictures.append(np.asarray(shown) / 255)
    own, others, light, coverage, pair = pictures
    assert own.shape == (32, 48, 3) and pair.shape == (32, 96, 3)
    assert others.shape == light.shape == coverage.shape == (32, 64, 3)
    np.testing.assert_array_equal(pair[:, :48], own)
    assert np.median(np.abs(pair[:, 48:] - own)) < 0.05  # SPPM
    told = capsys.readouterr().out
    assert re.search(r"\d{4} Gaussians from 16 passes", told)
    shares = re.findall(r"(\d+\.\d\d)% of the pixels are weakly covered", told)
    assert len(shares) == 2 and max(map(float, shares)) < 5  # after a second of fitting


def test_the_tour_is_stored_with_its_pictures():
    assert TOUR.stat().st_size < 1_000_000
    outputs = [output for cell in cells("code") for output in cell["outputs"]]
    pictures = [output for output in outputs if "image/png" in output.get("data", ())]
    assert len(pictures) == 5
    assert [cell["execution_count"] for cell in cells("code")] == list(range(1, 10))
    assert {output["output_type"] for output in outputs} == {"stream", "execute_result"}


def test_the_readme_shows_a_picture_of_every_script():
    text = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\]\((\w+\.(?:py|ipynb))\)", text)) == {
        "tour.ipynb",
        *(f"{name}.py" for name in SCRIPTS),
    }
    pictures = re.findall(r"!\[.+\]\((.+)\)", text)
    assert sorted(Path(picture).stem for picture in pictures) == SCRIPTS
    for picture in pictures:
        file = EXAMPLES / picture
        assert file.stat().st_size < 300_000
        assert 256 <= min(read(file).shape[:2]) <= max(read(file).shape[:2]) <= 512


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    # That of lamps takes minutes, and its search has a test of its own.
    [pytest.param(k, marks=pytest.mark.long if k == "inverse_lighting" else ()) for k in SCRIPTS],
)
def test_scripts_as_a_user_starts_them(name, tmp_path):
    """With a whole fit, and in a process of its own."""
    options = [
        "--seconds",
        "2",
        "--size",
        "48",
        *FEWER.get(name, []),
    ]
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), str(tmp_path / "out"), *options]
    done = subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(PROJECT)}
    )
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    assert read(tmp_path / "out" / f"{name}.png").shape[0] in (48, 96, 192)
    told = {
        "own_scene": r"estimated PSNR (?P<number>\S+) dB",
        "own_integrator": r"PSNR against the path tracer: (?P<number>\S+) dB",
        "data_set": r"(?P<number>\d+)% of the points are seen by both views",
    }
    if name in told:
        found = re.search(told[name], done.stderr)
        assert found and float(found["number"]) > 28, done.stderr
