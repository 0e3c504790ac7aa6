"""Files of the pipeline: params.yaml, and results in JSON."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from hypothesis import strategies as st
from ruamel.yaml import YAML

from tests.fuzz import documents, odd
from tests.fuzz.case import Case
from tests.fuzz.good import FIRST

PROJECT = Path(__file__).resolve().parents[2]
LARGE = (10**6, 10**8, 2**31 - 1, 2**31, 2**32, 10**10, 10**12, 2**63, 10**20, 10**30, 1e12)
PART = {"wall_seconds": 3.0, "cpu_seconds": 4.0, "compile_seconds": 1.0}
FACTS = {"seconds_per_single_view_pass": 0.2, "seconds_per_shared_view_pass": 0.1}
FACTS |= {"seconds_per_point_pass": 0.1, "passes": {"train": 20, "novel": 20}}
# What the stage `amortize` reads.
RESULTS: dict[str, Any] = {
    "costs/reference.json": {"parts": {"train": PART, "novel": PART}, "facts": FACTS},
    "costs/photons.json": {"parts": {"trace": PART}, "facts": {}},
    "costs/train.json": {"parts": {"stream": PART, "train": PART}, "facts": {}},
    "costs/render.json": {"parts": {"render": PART}, "facts": {"views": 1}},
    "metrics/gpf.json": {"mean": {"psnr": 33.0}, "reasons": {}},
    "convergence.json": [{"passes": 3, "psnr": 25.0}, {"passes": 20, "psnr": 35.0}],
}
COMMANDS = (
    *("stage scene --scene first", "stage scene --scene first", "scene list"),
    *("profile smoke", "profile desk", "profile full"),
)


@cache
def params() -> str:
    """The project's params.yaml for the scene `first`."""
    tree = YAML(typ="safe").load((PROJECT / "params.yaml").read_text(encoding="utf-8"))
    tree["scenes"] = ["first"]
    for baseline in tree["baselines"].values():
        baseline.pop("scenes", None)
    return documents.to_yaml(tree).decode()


def large_params(draw: st.DrawFn) -> bytes:
    """Whole numbers that need more memory or time than there is."""
    tree: Any = YAML(typ="safe").load(params())
    whole = [(place, key) for place, key in odd.places_in(tree) if type(place[key]) is int]
    for at in draw(st.lists(st.integers(0, len(whole) - 1), max_size=2)):
        place, key = whole[at]
        place[key] = draw(st.sampled_from(LARGE))
    return documents.to_yaml(tree)


@st.composite
def settings(draw: st.DrawFn) -> Case:
    """A command that reads params.yaml."""
    words = tuple(draw(st.sampled_from(COMMANDS)).split())
    large = draw(st.booleans())
    data = large_params(draw) if large else documents.changed_yaml(draw, params())
    writes = {"stage": ("results/*",), "profile": ("params.yaml",)}.get(words[0], ())
    names = ("params.yaml", "scene '")
    return Case(words, writes, names, {**FIRST, "params.yaml": data})


@st.composite
def artifacts(draw: st.DrawFn) -> Case:
    """`gpf stage amortize` with one or two results that are wrong."""
    wrong = draw(st.lists(st.sampled_from(list(RESULTS)), min_size=1, max_size=2, unique=True))
    files = {**FIRST, "params.yaml": params().encode()}
    for name, tree in RESULTS.items():
        good = documents.to_json(tree)
        data = documents.changed_json(draw, tree) if name in wrong else good
        files[f"results/first/{name}"] = data
    written = ("results/first/cost.csv", "results/first/amortize.json", "results/costs/*")
    return Case(("stage", "amortize", "--scene", "first"), written, tuple(wrong), files)
