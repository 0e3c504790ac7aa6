"""What a module of the project imports, directly or not, as the text of the modules shows."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

PROJECT = Path(__file__).parent.parent.parent
PACKAGES = ("gpf", "baselines", "metrics", "report", "stages")

# Neither listed in dvc.yaml nor followed. The command line and `gpf/__init__.py` make no result;
# what stages/config reads is listed as params.
LEFT_OUT = ("gpf/__init__.py", "gpf/__main__.py", "gpf/cli.py", "stages/config", "stages/commands")

# Plugins that a scene's dictionary names, such as {"type": "gpf"}.
PLUGINS = {"gpf": "gpf/rendering/gpf.py", "sppm": "gpf/rendering/sppm.py"}

# Every stage imports Workspace. Of what Workspace imports, this counts where the method is called.
WORKSPACE = "stages/common/workspace.py"
BEHIND_METHODS = {"emission_plan": "gpf/guiding/emission_plan.py"}


def files_behind(starts: Iterable[str]) -> set[str]:
    """The project's files that some files import, themselves included; paths from its root.

    Packages' `__init__.py` count where they do more than describe the package.
    """
    found: set[str] = set()
    todo = list(starts)
    while todo:
        file = todo.pop()
        if file not in found and not is_left_out(file):
            found.add(file)
            todo += imported(file)
    return {file for file in found if has_code(file)}


def is_left_out(file: str) -> bool:
    return any(file == entry or file.startswith(f"{entry}/") for entry in LEFT_OUT)


@cache
def imported(file: str) -> frozenset[str]:
    """The project's files that a file imports, anywhere in it, or names as a plugin."""
    nodes = list(ast.walk(tree(file)))
    found = {name for node in nodes for name in files_of(node)}
    behind = {name for method, name in BEHIND_METHODS.items() if calls(nodes, method)}
    if file == WORKSPACE:
        return frozenset(found - set(BEHIND_METHODS.values()))
    return frozenset(found | behind)


def files_of(node: ast.AST) -> Iterator[str]:
    """The files that one node of a syntax tree refers to."""
    if isinstance(node, ast.Import):
        for name in node.names:
            yield from module_files(name.name)
    elif isinstance(node, ast.ImportFrom) and node.module:
        yield from module_files(node.module)
        for name in node.names:
            yield from module_files(f"{node.module}.{name.name}")
    elif isinstance(node, ast.Dict):
        for key, value in zip(node.keys, node.values, strict=True):
            if isinstance(key, ast.Constant) and key.value == "type":
                if isinstance(value, ast.Constant) and value.value in PLUGINS:
                    yield PLUGINS[value.value]


def module_files(name: str) -> Iterator[str]:
    """The file of a module of the project, and those of the packages around it."""
    parts = name.split(".")
    if parts[0] not in (*PACKAGES, "scenes"):
        return
    for end in range(1, len(parts) + 1):
        place = "/".join(parts[:end])
        for file in (f"{place}.py", f"{place}/__init__.py"):
            if (PROJECT / file).is_file():
                yield file


def calls(nodes: Iterable[ast.AST], method: str) -> bool:
    return any(isinstance(node, ast.Attribute) and node.attr == method for node in nodes)


def has_code(file: str) -> bool:
    """Whether a file is more than a docstring."""
    return any(not isinstance(node, ast.Expr) for node in tree(file).body)


@cache
def tree(file: str) -> ast.Module:
    return ast.parse((PROJECT / file).read_text(encoding="utf-8"))
