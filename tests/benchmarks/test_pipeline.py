"""`python -m benchmarks.pipeline` on the results of a tiny pipeline: it prints numbers."""

from contextlib import chdir

import pytest

from benchmarks import judges
from benchmarks.pipeline import app
from tests.benchmarks.conftest import cells, numbers

pytestmark = pytest.mark.slow  # the pipeline runs first


def test_truth(run, finished):
    with chdir(finished.folder):
        told = run(app, "truth", "cornell_box", "floor", "--samples", 64)
    psnr = {name: numbers(cells(told, name)[:1])[0] for name in ("the reference", "GPF")}
    assert all(15 < value < 60 for value in psnr.values())


def test_independent(run, finished, monkeypatch):
    monkeypatch.setattr(judges, "METHODS", ("gpf", "second_reference"))
    with chdir(finished.folder):
        run(app, "independent", "--passes", 2, "--kept", "kept")
    table = (finished.folder / "results/independent.md").read_text(encoding="utf-8")
    title, field, second = table.splitlines()[-3:]
    assert title == "| **Cornell Box** | | | | | |"
    assert len(numbers(field.split("|")[2:])) == 5 and len(numbers(second.split("|")[2:])) == 4
