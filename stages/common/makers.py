"""The command that makes each file below `results/`; errors about files name it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

from gpf.core.errors import FileError, UserError

DVC_CACHE = Path(".dvc/cache")
"""Where DVC keeps files. It trusts those that are read-only: it finds and removes a damaged one
only if that is writable."""

# Path below results/SCENE -> the stage, with its option.
_MAKERS = (
    (r"scene(/.*|\.json)?|views\.yaml", "scene"),
    (r"(reference|second_reference)/.*|targets\.safetensors", "reference"),
    (r"photons\.safetensors", "photons"),
    (r"field\.safetensors|training/.*", "train"),
    (r"renders/gpf/.*", "render"),
    (r"renders/([^/]+)/.*", r"baseline --method \1"),
    (r"(metrics|summary|convergence|quality)[./].*", "metrics"),
    (r"ablations/([^/.]+).*", r"ablation --variant \1"),
    (r"animation/.*", "animate"),
    (r"(amortize\.json|cost\.csv)", "amortize"),
    (r"(?:costs|checkpoints)/baselines?[/-]([^/.]+).*", r"baseline --method \1"),
    (r"(?:costs|checkpoints)/ablations?[/-]([^/.]+).*", r"ablation --variant \1"),
    (r"(?:costs|checkpoints)/([a-z]+).*", r"\1"),
)


def command_for(path: Path) -> str | None:
    """The command that makes a file, e.g. `gpf stage train --scene cornell_box`, or None if there
    is none."""
    parts = Path(path).parts
    for i, (above, scene) in enumerate(pairwise(parts)):
        below = "/".join(parts[i + 2 :])
        if above == "results" and below:
            for pattern, stage in _MAKERS:
                if found := re.fullmatch(pattern, below):
                    return f"gpf stage {found.expand(stage)} --scene {scene}"
    return None


def with_command(error: FileError) -> UserError:
    """The error, with the command that makes the file if there is one."""
    command = command_for(error.path)
    if command is None:
        return error
    todo = f"Run `{command}` first." if error.missing else f"Delete it and run `{command}` again."
    if not error.missing and DVC_CACHE.is_dir():
        todo += f" If DVC restores the damaged file, run `chmod -R u+w {DVC_CACHE}` first."
    return UserError(error.where, error.what, todo)


@contextmanager
def naming_commands() -> Iterator[None]:
    """Make errors about files name the commands that make these files."""
    try:
        yield
    except FileError as error:
        raise with_command(error) from error
