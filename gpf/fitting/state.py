"""The state of a fit on disk, to continue from after it was killed, or later with more photons."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import logging
import re
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.files import read_tensors, write_tensors
from gpf.core.partial import remove_leftovers
from gpf.core.structs import from_numpy, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field, save_field
from gpf.scene.fingerprint import changed_parts, fingerprint

PHOTONS = "photons.safetensors"

# Files beside it.
_FIELD = re.compile(r"field-(\d+)\.safetensors")

SAVE_SECONDS = 60.0
"""Time between saved states while photons are traced."""

FORMAT = 9
"""Format of the files; those of another format are not read."""

Resume = Literal["if possible", "always", "never"]
"""Whether a fit continues from saved photons: without them it starts anew, or fails; or it starts
anew in any case."""

log = logging.getLogger(__name__)


class FitState:
    """A folder with the photons of a fit and fields that belong to them.

    The file with the photons names the fields, which are new files each time, and replaces the old
    file atomically: a fit killed at any time leaves the old state or the new one.

    Parameters
    ----------
    identity: JSON values; photons of a fit with another identity are not used.
    """

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        self.folder, self._saved = folder, time.perf_counter()
        self.identity = json.loads(json.dumps({"format": FORMAT, **identity}))

    def is_due(self) -> bool:
        """Whether the state was last saved :data:`SAVE_SECONDS` ago, while photons are traced."""
        return time.perf_counter() - self._saved > SAVE_SECONDS

    def save(
        self,
        tensors: Mapping[str, np.ndarray],
        facts: Mapping[str, Any],
        fields: Mapping[str, GaussianPhotonField],
    ) -> None:
        """Write the state; ``fields``: by what they are for. One may be there for several uses."""
        taken = [int(match[1]) for match, _ in self._field_files()]
        number, names = max(taken, default=0) + 1, dict[int, str]()
        for field in fields.values():
            if id(field) not in names:
                names[id(field)] = name = f"field-{number + len(names)}.safetensors"
                save_field(field, self.folder / name)
                tensors = {**tensors, **_rounded(field, name)}
        named = {use: names[id(field)] for use, field in fields.items()}
        facts = {"identity": self.identity, "facts": facts, "fields": named}
        write_tensors(self.folder / PHOTONS, "fit", tensors, facts)
        for _, file in self._field_files():
            if file.name not in named.values():  # of the state before
                file.unlink(missing_ok=True)
        remove_leftovers(self.folder)
        self._saved = time.perf_counter()

    def load(
        self, resume: Resume = "if possible"
    ) -> tuple[dict[str, np.ndarray], dict[str, Any], dict[str, GaussianPhotonField]]:
        """What was saved; empty without a state of the same identity.

        Raises
        ------
        UserError: there is no such state, but the fit must resume.
        """
        if resume == "never":
            return {}, {}, {}
        try:
            if not (self.folder / PHOTONS).exists():
                raise UserError(str(self.folder), "has no photons from a fit", "Start a new fit.")
            tensors, facts = read_tensors(self.folder / PHOTONS, "fit")
            if other := self._differences(facts.get("identity", {})):
                raise UserError(
                    str(self.folder),
                    f"has the photons of another fit: different {other}",
                    "Give the same scene and options as before, or start a new fit.",
                )
            names: dict[str, str] = facts["fields"]
            fields = {
                name: _restored(load_field(self.folder / name), tensors, name)
                for name in set(names.values())
            }
        except UserError as error:
            if resume == "always":
                raise
            if (self.folder / PHOTONS).exists():
                log.warning("%s Starting a new fit.", error)
            return {}, {}, {}
        return tensors, facts["facts"], {use: fields[name] for use, name in names.items()}

    def _field_files(self) -> list[tuple[re.Match[str], Path]]:
        """The files of fields, with the matches of their names."""
        files = self.folder.glob("field-*")
        return [(match, file) for file in files if (match := _FIELD.fullmatch(file.name))]

    def _differences(self, saved: Mapping[str, Any]) -> str:
        """What differs in a saved identity: parts of the scene, cameras, seed, or settings."""
        if saved.get("format") != FORMAT:
            return "version of this software"
        found = changed_parts(saved["scene"], self.identity["scene"])
        names = {*saved, *self.identity} - {"scene"}
        found += [name for name in sorted(names) if saved.get(name) != self.identity.get(name)]
        return ", ".join(found)


def _rounded(field: GaussianPhotonField, name: str) -> dict[str, np.ndarray]:
    """The arrays that a field's file rounds: it has positions and sizes in world units."""
    gaussians = field.gaussians
    arrays = {"means": to_numpy(gaussians.means), "log_scales": to_numpy(gaussians.log_scales)}
    if field.limits is not None:
        arrays["limits"] = field.limits
    return {f"{name}/{key}": array for key, array in arrays.items()}


def _restored(
    field: GaussianPhotonField, tensors: Mapping[str, np.ndarray], name: str
) -> GaussianPhotonField:
    """A field from a file, with the arrays of :func:`_rounded`, so that the fit gives the same bits
    as without an interruption."""
    exact = {
        "means": from_numpy(mi.Point3f, tensors[f"{name}/means"]),
        "log_scales": from_numpy(mi.Vector3f, tensors[f"{name}/log_scales"]),
    }
    field.limits = tensors.get(f"{name}/limits")
    field.update(dataclasses.replace(field.gaussians, **exact), field.error, field.caustics)
    return field


def fit_identity(
    scene: mi.Scene, sensors: Sequence[mi.Sensor], settings: Mapping[str, Any]
) -> dict[str, Any]:
    """What the photons of a fit belong to."""
    cameras = hashlib.sha256("".join(str(sensor) for sensor in sensors).encode())
    return {
        "scene": fingerprint(scene),
        "cameras": cameras.hexdigest()[:16],
        "variant": mi.variant(),
        **settings,
    }
