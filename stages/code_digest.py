"""What code a result was made with."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from stages.imports import PROJECT, closure, parse


@cache
def digest_with_imports(*files: str) -> str:
    """That of some of the project's files and of all that they import, directly or not.

    As they were when this process first asked, whatever becomes of them while it runs.
    """
    return digest_code(PROJECT / file for file in closure(*files) if file.endswith(".py"))


def digest_code(files: Iterable[Path]) -> str:
    """A hash of what Python files say, comments, docstrings and layout aside.

    Python 3.11 and 3.12 agree on it: what a node has none of is left out, for the newer one knows
    more that a node may have.
    """
    digest = hashlib.sha256()
    for file in files:
        tree = parse(file)
        for node in ast.walk(tree):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                node.value.value = None  # a docstring
        for node in list(ast.walk(tree)):
            for field in [name for name, value in ast.iter_fields(node) if value in (None, [])]:
                delattr(node, field)
        digest.update(ast.dump(tree).encode())
    return digest.hexdigest()[:16]


def digest_file(file: Path) -> str:
    """That of one file, which need not be Python."""
    if file.suffix == ".py":
        return digest_code([file])
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16]
