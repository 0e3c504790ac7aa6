"""Sums over ranges of passes, in files that can be made apart and are put together exactly."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from gpf.artifacts import read_tensors, write_tensors
from gpf.pass_sums import PassSums

_NAME = re.compile(r"(\d+)-(\d+)\.safetensors")


class PassParts:
    """A folder of files ``FIRST-LAST.safetensors``, each with the sums over passes FIRST+1 to LAST.

    What is done of a long sum is what lies here: a checkpoint is a part that is still growing, and
    a part that another machine made counts as if it were made here.

    Parameters
    ----------
    folder: what belongs to a ``fingerprint`` lies in a folder below that is named after it; parts
        of anything else are left alone.
    fingerprint: all that the sums depend on, as JSON values.
    maker: the stage that makes such files, for messages.
    """

    def __init__(self, folder: Path, fingerprint: Mapping[str, Any], maker: str) -> None:
        text = json.dumps(fingerprint, sort_keys=True)
        self.digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        self.parent, self.folder, self.maker = folder, folder / self.digest, maker

    def done(self) -> list[range]:
        """Ranges of passes that are done, in order and without overlap, as 0-based ranges."""
        chosen: list[range] = []
        names = [_NAME.fullmatch(p.name) for p in self.folder.glob("*.safetensors")]
        found = [range(int(m[1]), int(m[2])) for m in names if m]
        # Where one lies within another, the longer one counts.
        for part in sorted(found, key=lambda r: (r.start, -r.stop)):
            if not chosen or part.start >= chosen[-1].stop:
                chosen.append(part)
        return chosen

    def missing(self, wanted: range, cuts: Sequence[int] = ()) -> list[range]:
        """What is left to do of a range; no part reaches across one of the ``cuts``."""
        left, first = [], wanted.start
        for part in [*self.done(), range(wanted.stop, wanted.stop)]:
            last = min(part.start, wanted.stop)
            edges = [first, *sorted(c for c in cuts if first < c < last), last]
            left += [range(a, b) for a, b in pairwise(edges) if a < b]
            first = max(first, part.stop)
        return left

    def others(self) -> list[str]:
        """Names of folders beside this one that hold parts of something else."""
        if not self.parent.is_dir():
            return []
        return sorted(p.name for p in self.parent.iterdir() if p.is_dir() and p != self.folder)

    def file(self, part: range) -> Path:
        """Where the sums over a range lie."""
        return self.folder / f"{part.start}-{part.stop}.safetensors"

    def write(self, part: range, sums: PassSums, costs: Mapping[str, float]) -> None:
        """Keep the sums over a range, in place of those of shorter ranges with the same start."""
        metadata = {"passes": sums.passes, "costs": dict(costs)}
        write_tensors(self.file(part), "passes", sums.tensors(), metadata)
        for other in self.folder.glob(f"{part.start}-*.safetensors"):
            match = _NAME.fullmatch(other.name)
            if match and int(match[2]) < part.stop:
                other.unlink(missing_ok=True)

    def add_to(self, sums: PassSums, part: range) -> dict[str, float]:
        """Add a part's sums to others; what it cost."""
        tensors, metadata = read_tensors(self.file(part), "passes", self.maker)
        sums.add_tensors(tensors, metadata["passes"])
        costs: dict[str, float] = metadata["costs"]
        return costs

    def clear(self) -> None:
        """Remove all parts, once their sum is kept elsewhere."""
        for path in self.folder.glob("*.safetensors"):
            path.unlink(missing_ok=True)
        for folder in (self.folder, self.parent):
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
