"""Results of the pipeline in JSON: not UTF-8, cut off, or of another shape."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

from tests.fuzz.cameras import changed_json
from tests.fuzz.case import Case
from tests.fuzz.scenes import make_first_scene
from tests.fuzz.settings import good_text

_PART = {"wall_seconds": 3.0, "cpu_seconds": 4.0, "compile_seconds": 1.0}


def results() -> dict[str, Any]:
    """What the stage `amortize` reads, by file."""
    facts = {"seconds_per_single_view_pass": 0.2, "seconds_per_shared_view_pass": 0.1}
    facts |= {"seconds_per_point_pass": 0.1, "passes": {"train": 20, "novel": 20}}
    return {
        "costs/reference.json": {"parts": {"train": _PART, "novel": _PART}, "facts": facts},
        "costs/photons.json": {"parts": {"trace": _PART}, "facts": {}},
        "costs/train.json": {"parts": {"stream": _PART, "train": _PART}, "facts": {}},
        "costs/render.json": {"parts": {"render": _PART}, "facts": {"views": 1}},
        "metrics/gpf.json": {"mean": {"psnr": 33.0}, "reasons": {}},
        "convergence.json": [{"passes": 3, "psnr": 25.0}, {"passes": 20, "psnr": 35.0}],
    }


def make_case(rng: random.Random, folder: Path, good: Path) -> Case:
    """`gpf stage amortize` with one or two files that are wrong."""
    make_first_scene(folder, good)
    (folder / "params.yaml").write_text(good_text())
    place = folder / "results" / "first"
    files = results()
    wrong = rng.sample(list(files), rng.choice([1, 1, 2]))
    for name, content in files.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        data = changed_json(rng, content) if name in wrong else json.dumps(content).encode()
        (place / name).write_bytes(data)
    written = ("results/first/cost.csv", "results/first/amortize.json", "results/costs/*")
    return Case(("stage", "amortize", "--scene", "first"), written, tuple(wrong))
