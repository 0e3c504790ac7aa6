"""What code a result was made with."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import gpf


@cache
def library_digest(*others: str) -> str:
    """That of the whole library, for what would take more care than time to tell apart.

    ``others``: files beside it that decide, too, such as ``stages/render.py``.
    """
    library = Path(gpf.__file__).parent
    return digest_code([*sorted(library.rglob("*.py")), *(library.parent / o for o in others)])


def digest_code(files: Iterable[Path]) -> str:
    """A hash of what Python files say, comments, docstrings and layout aside.

    Python 3.11 and 3.12 agree on it: what a node has none of is left out, for the newer one knows
    more that a node may have.
    """
    digest = hashlib.sha256()
    for file in files:
        tree = ast.parse(file.read_text(encoding="utf-8"))
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
