"""Field files: ``field.safetensors``, exact or at a third of the size (:mod:`gpf.field.compact`).

Both precisions have the same tensors, one row per Gaussian, and the same metadata: settings,
bounds, record, precision.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import mitsuba as mi
import numpy as np

from gpf.core.errors import FileError, UserError
from gpf.core.files import name_not_finite, read_tensors, require_finite, write_tensors
from gpf.core.structs import from_numpy, to_numpy
from gpf.field import limits
from gpf.field.checks import FieldFacts, check_stored, check_values
from gpf.field.compact import pack, unpack
from gpf.field.detail import Detail
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.field.lights import FieldLights
from gpf.field.settings import FieldSettings
from gpf.field.volume import VolumeField
from gpf.scene.light_groups import LightGroups

Precision = Literal["float32", "compact"]

_NAMES = ("means", "log_scales", "quats", "irradiance", "normals")

VOLUME = "volume/"
"""Begins the names of the tensors of the field in media."""


@dataclass(frozen=True)
class StoredField:
    """The content of a field's file; does not need a Mitsuba variant.

    Attributes
    ----------
    tensors: the arrays of :class:`gpf.field.gaussians.Gaussians` by name, float32, (N, 3); quats
        (N, 4). Positions and sizes are in world units. A field with levels
        (:mod:`gpf.field.detail`) also has ``levels``, those of the Gaussians, (N,) uint8, and
        ``detail``, its table, (X, Y, Z) uint8. A field that knows its error has ``error``, relative
        to the irradiance, (N,). A field whose Gaussians end at planes has ``limits``, the
        planes' directions, (N, 3, 3), and ``limit_distances``, (N, 3), from the centres in search
        radii. A field in media has ``moments`` and ``light_moments`` (:mod:`gpf.field.volume`).
    settings: settings of the query.
    bounds: two corners of the scene's bounding box, world units.
    record: facts about how the field was made.
    grid: ``width`` and ``corner`` of the table of levels; empty without levels.
    lights: ``names`` and ``members`` of groups of emitters (:class:`LightGroups`), whose irradiance
        is the tensor ``lights``, (G, N, 3); empty if not kept apart.
    volume: the field in media, or None.
    """

    tensors: dict[str, np.ndarray]
    settings: FieldSettings
    bounds: list[list[float]]
    record: dict[str, Any]
    grid: dict[str, Any] = dataclasses.field(default_factory=dict)
    lights: dict[str, Any] = dataclasses.field(default_factory=dict)
    volume: StoredField | None = None

    def groups(self) -> LightGroups | None:
        """The groups of emitters, or None if their light is not kept apart."""
        if not self.lights:
            return None
        members = tuple(tuple(emitters) for emitters in self.lights["members"])
        return LightGroups(tuple(self.lights["names"]), members)

    def detail(self) -> Detail | None:
        """The levels, or None for a field that is equally fine everywhere."""
        if not self.grid:
            return None
        return Detail(
            self.tensors["detail"],
            self.grid["width"],
            np.array(self.grid["corner"]),
            self.settings.search_radius,
        )


def save_field(
    field: GaussianPhotonField, path: Path | str, precision: Precision = "float32"
) -> None:
    """Write a field; errors as in :func:`write_field`."""
    stored = _stored(field)
    if field.volume is not None:
        inside = _stored(field.volume.fluence)
        inside.tensors["moments"] = field.volume.moments
        if field.volume.light_moments is not None:
            inside.tensors["light_moments"] = field.volume.light_moments
        stored = dataclasses.replace(stored, volume=inside)
    write_field(stored, Path(path), precision)


def _stored(field: GaussianPhotonField) -> StoredField:
    g, detail = field.gaussians, field.detail
    quats = mi.Vector4f(g.quats.x, g.quats.y, g.quats.z, g.quats.w)
    arrays = (g.means, g.log_scales, quats, g.irradiance, g.normals)
    tensors = {name: to_numpy(array) for name, array in zip(_NAMES, arrays, strict=True)}
    grid = {}
    if detail is not None:
        levels = detail.levels_of(tensors["means"])
        tensors["means"] = detail.fold(tensors["means"]).astype(np.float32)
        tensors["log_scales"] -= levels[:, None] * np.float32(math.log(2))
        tensors |= {"levels": levels, "detail": detail.table}
        grid = {"width": detail.width, "corner": detail.corner.tolist()}
    lights = {}
    if field.lights is not None:
        tensors["lights"] = field.lights.irradiance
        lights = dataclasses.asdict(field.lights.groups)
    if field.error is not None:
        tensors["error"] = field.error
    if field.caustics is not None:
        tensors["caustics"] = field.caustics
    if field.limits is not None:
        ends = limits.fold(field.limits, to_numpy(g.means), detail)
        tensors["limits"] = ends[:, :, :3]
        tensors["limit_distances"] = ends[:, :, 3] / np.float32(field.settings.search_radius)
    bounds = [[float(corner[i]) for i in range(3)] for corner in field.bounds]
    return StoredField(tensors, field.settings, bounds, field.record, grid, lights)


def load_field(path: Path | str) -> GaussianPhotonField:
    """Read a field; errors as in :func:`read_field`."""
    stored = read_field(path)
    field = _restored(stored)
    if (inside := stored.volume) is not None:
        moments, parts = inside.tensors["moments"], inside.tensors.get("light_moments")
        field.volume = VolumeField(_restored(inside), moments, parts)
    return field


def _restored(stored: StoredField) -> GaussianPhotonField:
    detail = stored.detail()
    means, log_scales, quats, irradiance, normals = (stored.tensors[name] for name in _NAMES)
    places, sizes = from_numpy(mi.Point3f, means), from_numpy(mi.Vector3f, log_scales)
    if detail is not None:
        levels = from_numpy(mi.UInt32, stored.tensors["levels"])
        places = detail.unfold_to(places, levels)
        sizes += mi.Float(levels) * math.log(2)
    gaussians = Gaussians(
        means=places,
        log_scales=sizes,
        quats=from_numpy(mi.Quaternion4f, quats),
        irradiance=from_numpy(mi.Color3f, irradiance),
        normals=from_numpy(mi.Normal3f, normals),
    )
    ends = None
    if "limits" in stored.tensors:
        distances = stored.tensors["limit_distances"] * np.float32(stored.settings.search_radius)
        ends = np.concatenate([stored.tensors["limits"], distances[:, :, None]], axis=2)
        ends = limits.unfold(ends, to_numpy(places), detail)
    lower, upper = (mi.ScalarPoint3f(corner) for corner in stored.bounds)
    groups = stored.groups()
    lights = None if groups is None else FieldLights(groups, stored.tensors["lights"])
    return GaussianPhotonField(
        gaussians,
        stored.settings,
        (lower, upper),
        stored.record,
        detail,
        lights,
        stored.tensors.get("error"),
        ends,
        stored.tensors.get("caustics"),
    )


def write_field(stored: StoredField, path: Path, precision: Precision = "float32") -> None:
    """Write the content of a field's file.

    Raises
    ------
    UserError: a value is NaN or infinite, or the file cannot be written.
    """
    for part in filter(None, (stored, stored.volume)):
        if name := name_not_finite(part.tensors):
            raise UserError(
                str(path),
                f"was not written, because {name} of the field has NaN or infinite values",
                "Check the training targets, or lower the learning rates.",
            )
    tensors, metadata = _encode(stored, precision)
    if stored.volume is not None:
        inside, metadata["volume"] = _encode(stored.volume, precision)
        tensors |= {VOLUME + name: value for name, value in inside.items()}
    write_tensors(path, "field", tensors, {"precision": precision, **metadata})


def _encode(
    stored: StoredField, precision: Precision
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The tensors and the metadata of a file."""
    tensors = stored.tensors
    encoding: dict[str, Any] = {}
    if precision == "compact":
        tensors, encoding = pack(stored.tensors, stored.settings.search_radius)
    metadata = {
        "encoding": encoding,
        "settings": stored.settings.model_dump(),
        "bounds": stored.bounds,
        "record": stored.record,
        "grid": stored.grid,
        "lights": stored.lights,
    }
    return tensors, metadata


def read_field(path: Path | str) -> StoredField:
    """Read the content of a field's file, in either precision.

    Raises
    ------
    FileError: the file is missing or truncated, is of another kind, schema version or precision,
        has non-finite values, or does not hold a field (:mod:`gpf.field.checks`).
    """
    path = Path(path)
    tensors, metadata = read_tensors(path, "field", FieldFacts)
    # Older files do not state their precision; all of them are float32.
    precision = metadata.get("precision", "float32")
    if precision not in ("float32", "compact"):
        raise FileError(
            path,
            f"has the precision {precision}; this program reads float32 and compact",
        )
    inside = {n.removeprefix(VOLUME): v for n, v in tensors.items() if n.startswith(VOLUME)}
    surface = {name: v for name, v in tensors.items() if not name.startswith(VOLUME)}
    stored = _decode(path, surface, metadata, precision)
    if not metadata.get("volume"):
        return stored
    needed = ["moments"] + ["light_moments"] * bool(metadata["volume"].get("lights"))
    if missing := [name for name in needed if name not in inside]:
        raise FileError(path, f"has no {missing[0]} of the light in media")
    return dataclasses.replace(stored, volume=_decode(path, inside, metadata["volume"], precision))


def _decode(
    path: Path, tensors: dict[str, np.ndarray], metadata: dict[str, Any], precision: Precision
) -> StoredField:
    """The inverse of :func:`_encode`, with all checks."""
    check_stored(path, tensors, metadata, precision)
    if precision == "compact":
        tensors = unpack(tensors, metadata["encoding"])
    require_finite(path, tensors)
    check_values(path, tensors, metadata)
    settings = FieldSettings(**metadata["settings"])
    return StoredField(
        tensors,
        settings,
        metadata["bounds"],
        metadata["record"],
        metadata.get("grid", {}),
        metadata.get("lights", {}),
    )
