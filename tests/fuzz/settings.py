"""params.yaml: wrong keys, wrong types, and numbers that need more memory than there is."""

from __future__ import annotations

import random
from functools import cache
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from tests.fuzz import odd
from tests.fuzz.cameras import changed_yaml, dump
from tests.fuzz.case import Case
from tests.fuzz.runner import PROJECT
from tests.fuzz.scenes import make_first_scene

LARGE = (10**6, 10**8, 2**31 - 1, 2**31, 2**32, 10**10, 10**12, 2**63, 10**20, 10**30, 1e12)


@cache
def good_text() -> str:
    """The project's params.yaml for the scene `first`."""
    tree = YAML(typ="safe").load((PROJECT / "params.yaml").read_text(encoding="utf-8"))
    tree["scenes"] = ["first"]
    for baseline in tree["baselines"].values():
        baseline.pop("scenes", None)
    tree["ablations"]["variants"] = {
        "all": {"group": "components", "title": "all", "set": {}},
        "k_1": {"group": "k", "title": "1", "set": {"field.k": 1}},
    }
    return dump(tree).decode()


def with_large_numbers(rng: random.Random) -> bytes:
    """Some of the whole numbers are large."""
    tree: Any = YAML(typ="safe").load(good_text())
    found = [(place, key) for place, key in odd.places(tree) if type(place[key]) is int]
    for place, key in rng.sample(found, rng.choice([1, 1, 2])):
        place[key] = rng.choice(LARGE)
    return dump(tree)


def make_case(rng: random.Random, folder: Path, good: Path) -> Case:
    """A command that reads params.yaml."""
    make_first_scene(folder, good)
    data = with_large_numbers(rng) if rng.random() < 0.4 else changed_yaml(rng, good_text())
    (folder / "params.yaml").write_bytes(data)
    way = rng.random()
    names = ("params.yaml", "scene '")
    if way < 0.6:
        return Case(("stage", "scene", "--scene", "first"), ("results/*",), names)
    if way < 0.8:
        return Case(("profile", rng.choice(["smoke", "desk", "full"])), ("params.yaml",), names)
    return Case(("scene", "list"), (), names)
