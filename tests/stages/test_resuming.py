"""Ranges of passes, Ctrl-C and kills: what is done is kept, and the files are those of one run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gpf.core.files import read_tensors
from gpf.core.images import read_exr
from gpf.field.io import load_field
from gpf.training.descent import GaussianDescent
from stages.references.renderer import ReferenceRenderer
from tests.stages.results import NOVEL, TRAIN, assert_whole, files_below


def interrupt_after(monkeypatch, kind: type, method: str, calls: int) -> list[int]:
    """Raise KeyboardInterrupt in place of the next call; the list counts the calls."""
    original = getattr(kind, method)
    seen: list[int] = []

    def counted(self, *arguments):
        if len(seen) == calls:
            raise KeyboardInterrupt
        seen.append(1)
        return original(self, *arguments)

    monkeypatch.setattr(kind, method, counted)
    return seen


def test_an_interrupted_reference_goes_on_from_its_checkpoint(fresh, built, monkeypatch, no_probe):
    fresh.edit("params.yaml", progress__checkpoint_seconds=1e-6)
    assert fresh.stage("scene").code == 0
    with monkeypatch.context() as patch:
        interrupt_after(patch, ReferenceRenderer, "run_pass", 4 + 2)  # in the novel views
        outcome = fresh.stage("reference")
    assert outcome.code == 130
    assert "stopped; run it again to continue" in outcome.text
    assert "Traceback" not in outcome.text
    assert_whole(fresh.folder / "results")
    done = files_below(fresh.results)
    assert {f"reference/{view}.exr" for view in TRAIN} <= done
    assert not done & {f"reference/{view}.exr" for view in NOVEL}
    kept = [name for name in done if name.startswith("checkpoints/reference-novel/")]
    assert sorted(name.rpartition("/")[2] for name in kept) == [
        "0-1.safetensors",
        "1-2.safetensors",
        "fingerprint.json",
    ]

    with monkeypatch.context() as patch:
        passes = interrupt_after(patch, ReferenceRenderer, "run_pass", 1000)
        assert fresh.stage("reference").code == 0
    assert len(passes) == 2 + 4  # what was left for the novel views, and the second_reference
    assert not list((fresh.results / "checkpoints").glob("*"))
    for view in TRAIN + NOVEL:
        one, other = (
            read_exr(p.results / f"reference/{view}.exr")[0]["radiance"] for p in (fresh, built)
        )
        np.testing.assert_array_equal(one, other)


def test_a_checkpoint_of_other_surface_points_is_left_alone(fresh, monkeypatch, no_probe):
    fresh.edit("params.yaml", progress__checkpoint_seconds=1e-6)
    assert fresh.stage("scene").code == 0
    with monkeypatch.context() as patch:
        interrupt_after(patch, ReferenceRenderer, "run_pass", 2)
        assert fresh.stage("reference").code == 130
    fresh.edit("params.yaml", reference__surface_points=300)
    with monkeypatch.context() as patch:
        passes = interrupt_after(patch, ReferenceRenderer, "run_pass", 1000)
        outcome = fresh.stage("reference")
    assert outcome.code == 0 and "made with other points; left alone" in outcome.text
    assert len(passes) == 3 * 4
    assert len(list((fresh.results / "checkpoints/reference-train").iterdir())) == 1
    tensors, _ = read_tensors(fresh.results / "targets.safetensors", "targets")
    assert np.count_nonzero(tensors["source"] == -1) == 300


def test_passes_in_any_order_give_the_same_files(fresh, built, no_probe):
    """As other machines would make them: nothing is written until all are there."""
    assert fresh.stage("scene").code == 0
    for passes in ("2:", "0:1"):
        outcome = fresh.gpf("stage", "reference", "--scene", "cornell_box", "--passes", passes)
        assert (
            outcome.code == 0
            and "others are missing (train, novel, second_reference)" in outcome.text
        )
        assert not list(fresh.results.glob("reference/*"))
    assert fresh.gpf("stage", "reference", "--scene", "cornell_box", "--passes", "1:2").code == 0
    assert len(list(fresh.results.glob("*reference/*.exr"))) == len(TRAIN) + 2 * len(NOVEL)
    assert_same_references(fresh, built)
    assert not (fresh.results / "checkpoints").exists()


def test_nothing_is_lost_to_a_kill(fresh, built, environment, no_probe):
    """SIGKILL while parts are written; what is left goes on to the bits of a run in one piece."""
    fresh.edit("params.yaml", progress__checkpoint_seconds=1e-6)
    assert fresh.stage("scene").code == 0
    assert kill_after(fresh, 0, environment()) > 0
    assert fresh.stage("reference").code == 0
    assert_same_references(fresh, built)


@pytest.mark.slow
def test_nothing_is_lost_to_two_kills_in_many_passes(fresh, environment):
    fresh.edit("params.yaml", reference__passes=60, progress__checkpoint_seconds=1e-6)
    assert fresh.stage("scene").code == 0
    whole = fresh.copy(fresh.folder.parent / "whole")
    assert whole.stage("reference").code == 0
    seen = 0
    for _ in range(2):
        kept = kill_after(fresh, seen + 3, environment())
        assert kept > seen + 3
        seen = kept
    assert seen < 60
    assert fresh.stage("reference").code == 0
    assert_same_references(fresh, whole)


def kill_after(project, passes: int, environment: dict[str, str]) -> int:
    """Kill the stage once more passes of the training views are kept; how many then are."""
    folder = project.results / "checkpoints/reference-train"
    process = project.start("reference", environment)
    try:
        deadline = time.monotonic() + 90
        while process.poll() is None and time.monotonic() < deadline:
            if passes_kept(folder) > passes:
                break
            time.sleep(0.001)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == -signal.SIGKILL
    return passes_kept(folder)


def assert_same_references(one, other) -> None:
    """All images of both, byte by byte."""
    made = sorted(p.relative_to(other.results) for p in other.results.glob("*reference/*.exr"))
    assert len(made) == len(TRAIN) + 2 * len(NOVEL)
    for path in made:
        assert (one.results / path).read_bytes() == (other.results / path).read_bytes(), path


def test_a_kill_between_two_images_costs_no_pass(fresh, built, monkeypatch, no_probe):
    """All passes are done and one of the novel views' images is in its place."""
    assert fresh.stage("scene").code == 0
    moved = []
    replace = os.replace

    def killed(source, place):
        if "ready" in str(source) and (moved or "novel" in str(source)):
            if len(moved) == 1:
                raise KeyboardInterrupt
            moved.append(place)
        replace(source, place)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", killed)
        assert fresh.stage("reference").code == 130
    assert len(list(fresh.results.glob("reference/*.exr"))) == len(TRAIN) + 1
    with monkeypatch.context() as patch:
        passes = interrupt_after(patch, ReferenceRenderer, "run_pass", 1000)
        assert fresh.stage("reference").code == 0
    assert len(passes) == 4  # those of the second_reference
    assert not list((fresh.results / "checkpoints").glob("*"))
    for view in NOVEL:
        path = f"reference/{view}.exr"
        assert (fresh.results / path).read_bytes() == (built.results / path).read_bytes()


def passes_kept(folder: Path) -> int:
    """How many passes the parts below a folder hold."""
    names = [p.stem.split("-") for p in folder.rglob("[0-9]*.safetensors")]
    return max((int(last) for _, last in names), default=0)


def test_the_second_reference_goes_on_from_a_checkpoint_too(fresh, monkeypatch, no_probe):
    fresh.edit("params.yaml", progress__checkpoint_seconds=1e-6)
    assert fresh.stage("scene").code == 0
    with monkeypatch.context() as patch:
        interrupt_after(patch, ReferenceRenderer, "run_pass", 4 + 4 + 3)
        assert fresh.stage("reference").code == 130
    assert_whole(fresh.folder / "results")
    with monkeypatch.context() as patch:
        passes = interrupt_after(patch, ReferenceRenderer, "run_pass", 1000)
        assert fresh.stage("reference").code == 0
    assert len(passes) == 1
    layers, _ = read_exr(fresh.results / "second_reference/above.exr")
    assert layers.keys() == {"sppm_1", "sppm_3", "sppm_4"}


def test_what_more_passes_have_left_is_not_in_a_sum_of_fewer(fresh, built, monkeypatch, no_probe):
    fresh.edit("params.yaml", progress__checkpoint_seconds=1e-6, reference__passes=6)
    assert fresh.stage("scene").code == 0
    with monkeypatch.context() as patch:
        interrupt_after(patch, ReferenceRenderer, "run_pass", 6 + 6 + 5)
        assert fresh.stage("reference").code == 130
    fresh.edit("params.yaml", progress__checkpoint_seconds=30, reference__passes=4)
    assert fresh.stage("reference").code == 0
    for file in ("second_reference/above.exr", "reference/above.exr"):
        layers, record = read_exr(fresh.results / file)
        expected, _ = read_exr(built.results / file)
        assert record["passes_done"] == 4 and layers.keys() == expected.keys()
        for name, layer in layers.items():
            np.testing.assert_array_equal(layer, expected[name], err_msg=name)


def test_an_interrupted_training_goes_on_from_its_checkpoint(finished, monkeypatch):
    finished.edit("params.yaml", progress__checkpoint_seconds=1e-6)
    (finished.results / "field.safetensors").unlink()
    with monkeypatch.context() as patch:
        interrupt_after(patch, GaussianDescent, "step", 12)
        outcome = finished.stage("train")
    assert outcome.code == 130 and "stopped; run it again" in outcome.text
    assert_whole(finished.folder / "results")
    assert not (finished.results / "field.safetensors").exists()
    with monkeypatch.context() as patch:
        steps = interrupt_after(patch, GaussianDescent, "step", 1000)
        assert finished.stage("train").code == 0
    assert len(steps) == 20 - 10  # checkpoints are made where the neighbour lists are
    assert load_field(finished.results / "field.safetensors").record["steps"] == 20
    # The whole curve is there, not only what came after the checkpoint.
    curve = pd.read_csv(finished.results / "training/plots/metrics/held_out_error.tsv", sep="\t")
    assert curve["step"].tolist() == [10, 20]


@pytest.mark.slow
def test_ctrl_c_in_a_process_of_its_own(fresh, environment):
    fresh.edit("params.yaml", progress__checkpoint_seconds=0.01, reference__passes=100_000)
    assert fresh.stage("scene").code == 0
    with fresh.start("reference", environment()) as process:
        kept = fresh.results / "checkpoints/reference-train"
        deadline = time.monotonic() + 90
        while not passes_kept(kept) and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        try:
            output, _ = process.communicate(timeout=30)
        finally:
            process.kill()  # otherwise it would go on for hours
    assert process.returncode == 130, output
    assert "stopped; run it again to continue" in output
    assert "Traceback" not in output
    assert passes_kept(kept)
    assert_whole(fresh.folder / "results")


FULL_DISK = """
import resource, sys
from gpf.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), resource.RLIM_INFINITY))
main(["stage", "reference", "--scene", sys.argv[2]])
"""


def test_a_full_disk_leaves_the_last_checkpoint(fresh, built, environment, no_probe):
    """As if nothing larger than 2 kB could be written any more."""
    assert fresh.stage("scene").code == 0
    assert fresh.gpf("stage", "reference", "--scene", "cornell_box", "--passes", ":2").code == 0
    kept = {p: p.read_bytes() for p in (fresh.results / "checkpoints").rglob("*.safetensors")}
    assert len(kept) == 3 * 2
    full = subprocess.run(
        [sys.executable, "-c", FULL_DISK, "2000", fresh.results.name],
        cwd=fresh.folder,
        env=environment(),
        capture_output=True,
        text=True,
    )
    text = " ".join(full.stderr.split())
    assert full.returncode == 2, text
    assert "could not be written" in text and "Free some disk space" in text
    assert "Traceback" not in text
    assert_whole(fresh.folder / "results")
    assert kept.items() <= {p: p.read_bytes() for p in kept}.items()
    assert fresh.stage("reference").code == 0
    assert_same_references(fresh, built)
