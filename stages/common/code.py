"""Hashes of the code that makes a result: the files that dvc.yaml lists for a stage."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from gpf.core.yaml import load_yaml

PROJECT = Path(__file__).resolve().parents[2]


@cache
def digest_of(*stages: str) -> str:
    """A hash of the code that the given stages of dvc.yaml depend on.

    It is computed once per process, so later changes to the files do not count.
    """
    digest = hashlib.sha256()
    for file in sorted({file for stage in stages for file in code_of(stage)}):
        digest.update(file.relative_to(PROJECT).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


@cache
def code_of(stage: str) -> tuple[Path, ...]:
    """The Python files that a stage's dependencies name, or contain in a folder."""
    file = PROJECT / "dvc.yaml"
    pipeline = load_yaml(file.read_text(encoding="utf-8"), str(file))
    entry = pipeline["stages"][stage]
    listed = [PROJECT / name for name in entry.get("do", entry)["deps"] if "$" not in name]
    files = [path if path.is_file() else sorted(path.rglob("*.py")) for path in listed]
    flat = [f for found in files for f in (found if isinstance(found, list) else [found])]
    return tuple(file for file in flat if file.suffix == ".py")
