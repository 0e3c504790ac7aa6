"""A case: files in a folder, and a command line that meets them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Files = Mapping[str, bytes | Path | None]
"""By their paths in the folder: what is in them; of a link, where it leads; None for a folder."""


@dataclass(frozen=True)
class Case:
    """A command line and its files.

    Attributes
    ----------
    words: of the command line, without `gpf`.
    writes: patterns of the paths that the command may make or change, relative to the folder.
    names: further words of which a message may have one to say where the fault is.
    """

    words: tuple[str, ...]
    writes: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    files: Files = field(default_factory=dict)

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """Hypothesis prints this; the files lie in a folder."""
        printer.text(f"gpf {' '.join(self.words)[:300]}")
