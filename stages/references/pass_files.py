"""Files with sums over ranges of passes; added together, they equal one long sum bit for bit."""

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
from stages.references.pass_sums import PassSums

_FINGERPRINT = "fingerprint.json"
_NAME = re.compile(r"(\d+)-(\d+)\.safetensors")


class PassParts:
    """A folder of files ``FIRST-LAST.safetensors``, each with the sums over passes FIRST+1 to LAST.

    These files record which passes are done. A checkpoint is a part that is still growing. A
    part from another machine counts like one made here.

    Parameters
    ----------
    folder: parent of the folder with the parts, which is named after the fingerprint's digest and
        also holds the fingerprint. Folders of other fingerprints are not touched.
    fingerprint: everything that the sums depend on, as JSON values.
    passes: total number of passes. Parts that end later, from a longer sum, are ignored.
    """

    def __init__(self, folder: Path, fingerprint: Mapping[str, Any], passes: int) -> None:
        text = json.dumps(fingerprint, sort_keys=True)
        self.digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        self.parent, self.folder = folder, folder / self.digest
        self.passes = passes
        self._fingerprint: dict[str, Any] = json.loads(text)

    def done(self) -> list[range]:
        """Ranges of passes that are done, 0-based, in order and without overlap."""
        chosen: list[range] = []
        names = [_NAME.fullmatch(p.name) for p in self.folder.glob("*.safetensors")]
        found = [range(int(m[1]), int(m[2])) for m in names if m and int(m[2]) <= self.passes]
        # Among parts with the same start, the longest counts; parts that overlap it do not.
        for part in sorted(found, key=lambda r: (r.start, -r.stop)):
            if not chosen or part.start >= chosen[-1].stop:
                chosen.append(part)
        return chosen

    def missing(self, wanted: range, cuts: Sequence[int] = ()) -> list[range]:
        """Ranges of ``wanted`` that are not done, split at ``cuts``."""
        left, first = [], wanted.start
        for part in [*self.done(), range(wanted.stop, wanted.stop)]:
            last = min(part.start, wanted.stop)
            edges = [first, *sorted(c for c in cuts if first < c < last), last]
            left += [range(a, b) for a, b in pairwise(edges) if a < b]
            first = max(first, part.stop)
        return left

    def others(self) -> dict[Path, str]:
        """Folders with parts of other sums, and how their fingerprints differ from this one."""
        if not self.parent.is_dir():
            return {}
        folders = sorted(p for p in self.parent.iterdir() if p.is_dir() and p != self.folder)
        return {folder: self._difference(folder) for folder in folders}

    def _difference(self, folder: Path) -> str:
        """How the fingerprint of a folder differs from this one, in words."""
        if not (folder / _FINGERPRINT).exists():
            return "an unknown fingerprint"
        theirs, mine = read_json(folder / _FINGERPRINT), self._fingerprint
        words = []
        for key in sorted(theirs.keys() | mine.keys()):
            if theirs.get(key) != mine.get(key):
                plain = isinstance(theirs.get(key), int | float | bool)
                value = f" ({theirs[key]}, not {mine.get(key)})" if plain else ""
                words.append(key.replace("_", " ") + value)
        return "other " + ", ".join(words)

    def file(self, part: range) -> Path:
        """The file of the sums over a range."""
        return self.folder / f"{part.start}-{part.stop}.safetensors"

    def write(self, part: range, sums: PassSums, costs: Mapping[str, float]) -> None:
        """Write the sums over a range and remove shorter ranges with the same start."""
        if not (self.folder / _FINGERPRINT).exists():
            write_json(self.folder / _FINGERPRINT, self._fingerprint)
        metadata = {"passes": sums.passes, "costs": dict(costs), "digest": self.digest}
        write_tensors(self.file(part), "passes", sums.tensors(), metadata)
        for other in self.folder.glob(f"{part.start}-*.safetensors"):
            match = _NAME.fullmatch(other.name)
            if match and int(match[2]) < part.stop:
                other.unlink(missing_ok=True)

    def add_to(self, sums: PassSums, part: range) -> dict[str, float]:
        """Add a part to ``sums``, and return what the part cost.

        Raises
        ------
        UserError: the file belongs to other sums.
        """
        tensors, metadata = read_tensors(self.file(part), "passes")
        if metadata.get("digest") != self.digest:
            raise UserError(
                str(self.file(part)),
                "holds passes of a different scene, or with different views, parameters or code "
                f"({metadata.get('digest', 'unknown')}); it was not changed",
                "Move it out of this folder.",
            )
        sums.add_tensors(tensors, metadata["passes"])
        costs: dict[str, float] = metadata["costs"]
        return costs
