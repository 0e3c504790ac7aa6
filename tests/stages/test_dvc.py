"""The pipeline as DVC runs it: what is up to date, and what a change makes out of date."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest

from tests.stages.pipeline import Checkout, add_pipeline
from tests.stages.results import files_below

pytest.importorskip("dvc")

# One process for all steps: DVC takes seconds to import. Prints what `dvc status` says after each.
STEPS = """
import json, sys
from pathlib import Path
from dvc.repo import Repo

repo = Repo.init(no_scm=True)
repo.commit(force=True)
found = []
for file, old, new in [("", "", ""), *json.loads(sys.argv[1])]:
    if file:
        text = Path(file).read_text(encoding="utf-8")
        assert old in text, file
        Path(file).write_text(text.replace(old, new, 1), encoding="utf-8")
    with repo.lock:
        repo._reset()
    found.append(repo.status())
    if file:
        Path(file).write_text(text, encoding="utf-8")
print("found", json.dumps(found))
"""


def test_a_change_makes_what_depends_on_it_out_of_date(finished, environment):
    add_pipeline(finished)
    edits = [
        ("gpf/field/field.py", "import", "# why\nimport"),
        ("report/formats.py", "import", "# why\nimport"),
        ("params.yaml", "rr_depth: 5\n  seed: 2", "rr_depth: 5\n  seed: 22"),
        ("scenes/cornell_box/views.yaml", "exposure: ", "exposure:  "),
    ]
    done = subprocess.run(
        [sys.executable, "-c", STEPS, json.dumps(edits)],
        cwd=finished.folder,
        env=environment(),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1].removeprefix("found "))
    none, field, report, photons, scene = ({name_of(entry) for entry in each} for each in told)
    assert none == set()
    assert field == {"train", "render", "ablation"}
    assert report == {"report"}
    assert photons == {"photons", "report"}  # which shows all parameters
    assert scene == {"scene"}


def name_of(entry: str) -> str:
    """Without the scene and the row: `photons@cornell_box`, `dvc.yaml:photons@cornell_box`."""
    return entry.rpartition(":")[2].partition("@")[0]


@pytest.mark.slow
def test_repro_twice_the_second_time_for_nothing(fresh, environment, tmp_path):
    checkout = Checkout.make(fresh, tmp_path / "bin", environment())
    dvc = checkout.dvc
    first = dvc("repro")
    assert first.count("Running stage") == 11
    files = files_below(fresh.folder / "results")
    assert "cornell_box/amortize.json" in files and "report.html" in files
    before = fresh.snapshot()
    second = dvc("repro")
    assert "Running stage" not in second and second.count("didn't change, skipping") >= 7
    assert "Data and pipelines are up to date" in second
    assert fresh.snapshot() == before

    def edit(file: str, old: str, new: str, *then: str) -> list[str]:
        """Change the code; the stages that run then."""
        path = fresh.folder / file
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        if then:
            dvc(*then)
        return re.findall(r"Running stage '(.+)'", dvc("repro"))

    assert edit("report/formats.py", "def join", "def _idle(): pass\n\n\ndef join") == ["report"]
    # A change that changes no result, as `dvc commit` is told.
    comment = ("gpf/core/files.py", "import", "# why\nimport")
    assert edit(*comment, "commit", "--force") == []
