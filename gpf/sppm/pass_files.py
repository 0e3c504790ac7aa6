"""Sums over ranges of passes, in files that can be made apart and are put together exactly."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from gpf.core.errors import UserError
from gpf.core.files import read_json, read_tensors, write_json, write_tensors
from gpf.sppm.pass_sums import PassSums

_FINGERPRINT = "fingerprint.json"
_NAME = re.compile(r"(\d+)-(\d+)\.safetensors")


class PassParts:
    """A folder of files ``FIRST-LAST.safetensors``, each with the sums over passes FIRST+1 to LAST.

    What is done of a long sum is what lies here: a checkpoint is a part that is still growing, and
    a part that another machine made counts as if it were made here.

    Parameters
    ----------
    folder: what belongs to a ``fingerprint`` lies in a folder below that is named after it, with
        the fingerprint beside the parts; parts of anything else are left alone.
    fingerprint: all that the sums depend on, as JSON values.
    passes: how many there are to be. Parts that reach further, of a longer sum, are left alone.
    """

    def __init__(self, folder: Path, fingerprint: Mapping[str, Any], passes: int) -> None:
        text = json.dumps(fingerprint, sort_keys=True)
        self.digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        self.parent, self.folder = folder, folder / self.digest
        self.passes = passes
        self._fingerprint: dict[str, Any] = json.loads(text)

    def done(self) -> list[range]:
        """Ranges of passes that are done, in order and without overlap, as 0-based ranges."""
        chosen: list[range] = []
        names = [_NAME.fullmatch(p.name) for p in self.folder.glob("*.safetensors")]
        found = [range(int(m[1]), int(m[2])) for m in names if m and int(m[2]) <= self.passes]
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

    def others(self) -> dict[Path, str]:
        """Folders beside this one that hold parts of something else, and what of."""
        if not self.parent.is_dir():
            return {}
        folders = sorted(p for p in self.parent.iterdir() if p.is_dir() and p != self.folder)
        return {folder: self._difference(folder) for folder in folders}

    def _difference(self, folder: Path) -> str:
        """In what the fingerprint of a folder is not this one, in words."""
        if not (folder / _FINGERPRINT).exists():
            return "nothing that this version knows"
        theirs, mine = read_json(folder / _FINGERPRINT), self._fingerprint
        words = []
        for key in sorted(theirs.keys() | mine.keys()):
            if theirs.get(key) != mine.get(key):
                plain = isinstance(theirs.get(key), int | float | bool)
                value = f" ({theirs[key]}, not {mine.get(key)})" if plain else ""
                words.append(key.replace("_", " ") + value)
        return "other " + ", ".join(words)

    def file(self, part: range) -> Path:
        """Where the sums over a range lie."""
        return self.folder / f"{part.start}-{part.stop}.safetensors"

    def write(self, part: range, sums: PassSums, costs: Mapping[str, float]) -> None:
        """Keep the sums over a range, in place of those of shorter ranges with the same start."""
        if not (self.folder / _FINGERPRINT).exists():
            write_json(self.folder / _FINGERPRINT, self._fingerprint)
        metadata = {"passes": sums.passes, "costs": dict(costs), "digest": self.digest}
        write_tensors(self.file(part), "passes", sums.tensors(), metadata)
        for other in self.folder.glob(f"{part.start}-*.safetensors"):
            match = _NAME.fullmatch(other.name)
            if match and int(match[2]) < part.stop:
                other.unlink(missing_ok=True)

    def add_to(self, sums: PassSums, part: range) -> dict[str, float]:
        """Add a part's sums to others; what it cost."""
        tensors, metadata = read_tensors(self.file(part), "passes")
        if metadata.get("digest") != self.digest:
            raise UserError(
                str(self.file(part)),
                "holds passes of another scene, other views, parameters or code "
                f"({metadata.get('digest', 'unknown')}), and is left as it is",
                "Move it out of this folder.",
            )
        sums.add_tensors(tensors, metadata["passes"])
        costs: dict[str, float] = metadata["costs"]
        return costs

    def clear(self) -> None:
        """Remove all parts, once their sum is kept elsewhere."""
        for path in [*self.folder.glob("*.safetensors"), self.folder / _FINGERPRINT]:
            path.unlink(missing_ok=True)
        for folder in (self.folder, self.parent):
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
