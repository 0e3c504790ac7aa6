"""The order of the packages: each imports only those to its left; no circular imports."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]
MODULES = {
    ".".join(path.relative_to(PROJECT).with_suffix("").parts).removesuffix(".__init__"): path
    for top in ("gpf", "baselines", "metrics", "report", "stages")
    for path in (PROJECT / top).rglob("*.py")
}
ORDER = [
    *("core", "scene", "photons", "camera", "guiding", "sppm", "field", "training", "rendering"),
    *("baking", "blender", "placement", "fitting", "viewing", "commands", "modelling"),
]
# `gpf` is what stands above its packages: the command line, which loads stages by name. `config`
# is stages/config; the other modules of `stages` may import everything.
ALLOWED = {place: {*ORDER[: k + 1]} for k, place in enumerate(ORDER)}
PIPELINE = {*ORDER, "baselines", "config"}
ALLOWED |= {
    "gpf": {*ORDER, "gpf"},
    "baselines": {*ORDER, "baselines"},
    "config": PIPELINE,
    "metrics": {"metrics"},
    "report": {*PIPELINE, "metrics", "report"},
}


def imports(module: str) -> set[str]:
    """The project's modules that a module imports, in functions too."""
    found = set()
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.module and not node.level, f"{module}: a relative import"
            names = {f"{node.module}.{name.name}" for name in node.names}
            found |= {name if name in MODULES else node.module for name in names}
    return found & MODULES.keys()


def package(module: str) -> str:
    """The package below ``gpf``, ``config``, or the outermost one."""
    outer, *inner = module.split(".")
    if inner and ((outer == "gpf" and inner[0] in ORDER) or module.startswith("stages.config")):
        return inner[0]
    return outer


@pytest.mark.parametrize("place", ALLOWED)
def test_a_package_imports_from_its_left(place):
    members = [module for module in MODULES if package(module) == place]
    edges = {(module, other) for module in members for other in imports(module)}
    assert members and [e for e in edges if package(e[1]) not in ALLOWED[place]] == []


def test_no_circle():
    TopologicalSorter({module: imports(module) for module in MODULES}).prepare()
