"""Which parameters a stage reads, as the text of its functions shows."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from functools import cache

from stages.config.params import Params
from tests.stages.imports import PROJECT, WORKSPACE, tree

# Parameters that methods of Workspace and Recipe read, by the names of these.
BEHIND = {
    "film_size": ("film",),
    "sensor": ("film",),
    "emission_plan": ("visible_region", "reference.rr_depth"),
    "initial_field": ("field",),
    "supervise": ("train",),
}


def params_read_by(file: str, function: str, unused: Iterable[str] = ()) -> set[str]:
    """Dotted parameters that a function of a stage reads, and those that it calls in stages/.

    ``unused``: names of functions that are not followed.
    """
    found = {"runtime"}  # Workspace.open
    seen: set[tuple[str, str]] = set()
    todo = [(file, function)]
    while todo:
        place = todo.pop()
        if place in seen or place[0] == WORKSPACE or place[1] in unused:
            continue
        seen.add(place)
        if definition := definitions(place[0]).get(place[1]):
            todo += named_in(place[0], definition)
            found |= read_in(definition)
    return found


@cache
def definitions(file: str) -> dict[str, ast.AST]:
    """Functions and classes of a file, by name."""
    kinds = (ast.FunctionDef, ast.ClassDef)
    return {node.name: node for node in tree(file).body if isinstance(node, kinds)}


def named_in(file: str, definition: ast.AST) -> Iterator[tuple[str, str]]:
    """Functions and classes of stages/ that a definition names: their file and name."""
    imported = names_from_stages(file)
    for node in ast.walk(definition):
        if isinstance(node, ast.Name):
            place, name = imported.get(node.id, (file, node.id))
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            package, module = imported.get(node.value.id, ("", ""))
            place, name = f"{package.removesuffix('.py')}/{module}.py", node.attr
        else:
            continue
        if (PROJECT / place).is_file():
            yield place, name


@cache
def names_from_stages(file: str) -> dict[str, tuple[str, str]]:
    """What a file imports from stages/: name -> the file that it is from, and its name there."""
    return {
        name.asname or name.name: (node.module.replace(".", "/") + ".py", name.name)
        for node in ast.walk(tree(file))
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").startswith("stages")
        and not (node.module or "").startswith("stages.config")  # it reads all of them
        for name in node.names
    }


def read_in(definition: ast.AST) -> set[str]:
    """Dotted parameters that a function or class reads."""
    nodes = list(ast.walk(definition))
    # `section = work.params.train` followed by section.steps reads train.steps.
    aliases = {
        target.id: path
        for node in nodes
        if isinstance(node, ast.Assign)
        for target, value in assignments(node)
        if (path := dotted(value, {}))
    }
    attributes = [node for node in nodes if isinstance(node, ast.Attribute)]
    paths = {path for node in attributes if (path := dotted(node, aliases))}
    found = {path for path in paths if not any(p.startswith(f"{path}.") for p in paths)}
    return found | {path for node in attributes for path in BEHIND.get(node.attr, ())}


def assignments(node: ast.Assign) -> Iterator[tuple[ast.Name, ast.AST]]:
    """Names and what they are set to, also in `a, b = x, y`."""
    target, value = node.targets[0], node.value
    pairs = [(target, value)]
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        pairs = list(zip(target.elts, value.elts, strict=True))
    return ((name, value) for name, value in pairs if isinstance(name, ast.Name))


def dotted(node: ast.AST, aliases: dict[str, str]) -> str | None:
    """``train.steps`` for ``work.params.train.steps``, also by way of a local name."""
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.insert(0, node.attr)
        node = node.value
    if not isinstance(node, ast.Name):
        return None
    if node.id in aliases:
        names = [*aliases[node.id].split("."), *names]
    elif "params" in names:
        names = names[names.index("params") + 1 :]
    elif node.id != "params":
        return None
    kept: list[str] = []
    model = Params
    for name in names:
        if name not in getattr(model, "model_fields", {}):
            break
        kept.append(name)
        model = model.model_fields[name].annotation
    return ".".join(kept) or None
