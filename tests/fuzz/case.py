"""A case: files in a folder, and a command line that meets them."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Case:
    """A command line.

    Attributes
    ----------
    words: of the command line, without `gpf`.
    writes: patterns of the paths that the command may make or change, relative to the folder.
    names: further words of which a message may have one to say where the fault is.
    """

    words: tuple[str, ...]
    writes: tuple[str, ...] = ()
    names: tuple[str, ...] = ()


Maker = Callable[[random.Random, Path, Path], Case]
"""(random numbers, the folder to fill, folder of good files) -> the case."""


def random_of(seed: int, kind: str, number: int) -> random.Random:
    """The random numbers of a case: the same in all processes."""
    return random.Random(f"{seed} {kind} {number}")
