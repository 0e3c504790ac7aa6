"""A small folder of results with invented numbers, which are all different."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from gpf.core.files import read_json, write_json
from report.results import NUMBERS, Results
from report.tables import make_tables
from stages.config.params import Params

BOX, WATER = "cornell_box", "water_caustic"
METHODS = {
    "path_10": {"system": "path_tracer", "spp": 10},
    "path_50": {"system": "path_tracer", "spp": 50},
    "sppm_3": {"system": "sppm", "passes": 3},
    "renderformer": {"system": "renderformer"},
    "splatting_3": {"system": "splatting", "views": 3, "scenes": [WATER]},
}
VARIANTS = {
    "radius": {
        "group": "components",
        "title": "radius only",
        "set": {"field.initialization": "random", "field.neighbours": "radius"},
    },
    "all": {"group": "components", "title": "all"},
    "few": {"group": "gaussians", "set": {"field.gaussians": 10000}},
    "k_10": {"group": "k", "set": {"field.k": 10}},
    "sum": {"group": "switches", "title": "plain sum", "set": {"field.blend": "sum"}},
}


def seconds(wall: float) -> dict[str, float]:
    """A part of a stage's costs."""
    return {"wall_seconds": wall, "cpu_seconds": 2 * wall, "compile_seconds": 0.0}


def made_up_params(**changes: Any) -> Params:
    """Parameters with three scenes, some methods and variants; the variant `sum` does not run."""
    sections: dict[str, Any] = {
        "scenes": [BOX, WATER, "veach_ajar"],
        "reference": {"passes": 30},
        "render": {"spp": 16},
        "field": {"gaussians": "auto"},
        "methods": {"classical": list(METHODS)[:3], "learned": ["renderformer", "splatting_3"]},
        "baselines": METHODS,
        "ablations": {
            "scenes": [WATER],
            "run": ["radius", "all", "few", "k_10"],
            "variants": VARIANTS,
        },
    }
    return Params.model_validate(sections | changes)


def make_results(root: Path, **changes: Any) -> Results:
    """Results of two scenes. RenderFormer cannot serve them; the third scene has no results."""
    params, numbers = made_up_params(**changes), _numbers()
    for scene in (BOX, WATER):
        folder = root / scene
        for method in ("path_10", "path_50", "sppm_3", "gpf", "second_reference", "splatting_3"):
            if method == "splatting_3" and scene == BOX:
                continue
            mean = {key: next(numbers) for key in NUMBERS}
            write_json(folder / "metrics" / f"{method}.json", {"mean": mean, "reasons": {}})
            if method not in ("gpf", "second_reference"):
                facts = _facts(numbers) | {"storage_megabytes": next(numbers)}
                if method.startswith("path"):
                    facts["storage_megabytes"] = 0.0
                parts = {part: seconds(next(numbers)) for part in ("prepare", "render")}
                cost = {"facts": facts, "parts": parts}
                write_json(folder / "costs" / "baselines" / f"{method}.json", cost)
        refusal = {"cannot_serve": "glass and water are beyond it"}
        write_json(folder / "metrics" / "renderformer.json", refusal)
        facts = _facts(numbers) | {"field_megabytes": next(numbers)}
        cost = {"facts": facts, "parts": {"render": seconds(next(numbers))}}
        write_json(folder / "costs" / "render.json", cost)
        facts = {"gaussians": 100_000 if scene == WATER else 6250}
        parts = {part: seconds(next(numbers)) for part in ("initialization", "training")}
        write_json(folder / "costs" / "train.json", {"facts": facts, "parts": parts})
        kinds = ("single_view", "shared_view")
        facts = {f"seconds_per_{kind}_pass": next(numbers) / 10 for kind in kinds}
        write_json(folder / "costs" / "reference.json", {"facts": facts, "parts": {}})
        write_json(folder / "amortize.json", {"preparation_seconds": next(numbers)})
        last = read_json(folder / "metrics" / "second_reference.json")["mean"]["psnr"]
        curve = {1: next(numbers), 3: next(numbers), 10: next(numbers), 30: last}
        rows = [{"passes": passes, "psnr": psnr} for passes, psnr in curve.items()]
        write_json(folder / "convergence.json", rows)
    for name in ("radius", "few"):
        write_json(root / WATER / "ablations" / f"{name}.json", _ablation(name, numbers))
    return Results(params, root)


def edit(file: Path, **changes: Any) -> None:
    """Change numbers of a JSON file; in a key, __ separates its parts."""
    data = read_json(file)
    for key, value in changes.items():
        *parts, leaf = key.split("__")
        place = data
        for part in parts:
            place = place[part]
        place[leaf] = value
    write_json(file, data)


def tables_of(results: Results):
    """The tables by name, from files that are read again."""
    return {table.name: table for table in make_tables(Results(results.params, results.root))}


def cells(frame: pd.DataFrame) -> dict[tuple, float]:
    """(row, column) -> number, without ranks and missing numbers."""
    return {
        (row, key): float(value)
        for key in frame.columns
        if not str(key).endswith("_rank")
        for row, value in enumerate(frame[key])
        if isinstance(value, int | float) and not math.isnan(value)
    }


def _facts(numbers: Iterator[float]) -> dict[str, float]:
    return {
        "views": 4,
        "path_seconds": next(numbers) / 100,
        "peak_memory_megabytes": next(numbers) * 10,
    }


def _ablation(name: str, numbers: Iterator[float]) -> dict[str, Any]:
    overrides: Any = VARIANTS[name]["set"]
    return {
        "variant": name,
        "title": VARIANTS[name].get("title", "few of them"),
        "group": VARIANTS[name]["group"],
        "overrides": overrides,
        "mean": {key: next(numbers) for key in NUMBERS},
        "seconds_per_view": next(numbers),
        "storage_megabytes": next(numbers),
        "train_seconds": next(numbers),
        "gaussians": overrides.get("field.gaussians", 100_000),
    }


def _numbers() -> Iterator[float]:
    """Different numbers between 10 and 50."""
    k = 0
    while True:
        k += 1
        yield 10 + (k * 24.7213595499958) % 40
