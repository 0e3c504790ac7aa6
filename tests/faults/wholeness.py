"""Whether every file is the old one or the new one."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from gpf.core.files import read_tensors
from gpf.core.images import read_exr

# Files of a run that a killed one leaves to the next: locks, half-written files, checkpoints.
_PASSING = (".gpf-partial-", ".lock-", "checkpoints")


def contents(folder: Path) -> dict[str, str]:
    """A hash of each file below a folder; measured times do not count."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): _digest(path) for path in files}


def lasting(found: dict[str, str]) -> dict[str, str]:
    """Without what a killed run leaves to the next."""
    return {name: value for name, value in found.items() if not _passes(name)}


def assert_old_or_new(folder: Path, old: dict[str, str], new: dict[str, str]) -> None:
    """Each file has the content of before or that of a run without a fault; none that both have is
    missing; and what is left to the next run can be read."""
    found = lasting(contents(folder))
    wrong = [name for name, value in found.items() if value not in (old.get(name), new.get(name))]
    assert not wrong, f"neither old nor new: {wrong}"
    missing = (old.keys() & new.keys()) - found.keys()
    assert not missing, f"missing: {missing}"
    for path in folder.rglob("checkpoints/**/*"):
        name = path.relative_to(folder).as_posix()
        # The curves grow while a field is trained; they are written anew by the next run.
        passing = any(part.startswith(".") or part == "curves" for part in Path(name).parts)
        if path.is_file() and not passing:
            read_any(path)


def read_any(path: Path) -> None:
    """Read a file; an error if it is not whole."""
    if path.suffix == ".exr":
        read_exr(path)
    elif path.suffix == ".safetensors":
        text = path.read_bytes()[:4000].decode(errors="replace")
        read_tensors(path, text.partition('"kind":"')[2].partition('"')[0])
    elif path.suffix == ".json":
        json.loads(path.read_text(encoding="utf-8"))


def _passes(name: str) -> bool:
    return any(part.startswith(_PASSING) for part in name.split("/"))


def _digest(path: Path) -> str:
    data = path.read_bytes()
    measured = path.suffix == ".json" and {"costs", "ablations"} & set(path.parts)
    if measured and not _passes(path.name):
        data = json.dumps(_without_times(json.loads(data)), sort_keys=True).encode()
    return hashlib.sha256(data).hexdigest()


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        times = ("parts", "seconds", "memory")
        kept = {k: v for k, v in value.items() if not any(word in k for word in times)}
        return {k: _without_times(v) for k, v in kept.items()}
    return value
