"""Checks of a field's file for what a field needs: a damaged one would crash the process later.

Kernels do not notice indices outside a table, an empty tensor or a grid of 10^30 cells.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, with_config
from typing_extensions import TypedDict  # pydantic cannot use the one in Python 3.11

from gpf.core.errors import FileError
from gpf.core.files import require_shapes
from gpf.core.settings import Positive
from gpf.field.settings import FieldSettings

_Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e30, le=1e30)]
_Vector = tuple[_Finite, _Finite, _Finite]

_MOST_CELLS = 1e7
"""Largest extent of a field, search radii; the neighbour search has a table as long as this."""

MOST_LOG_SCALE = 80.0
"""Limit of the logarithms of scales, whose exponentials must fit into single precision."""


class _Encoding(TypedDict, total=False):
    means: tuple[_Vector, _Vector]
    log_scales: tuple[_Vector, _Vector]
    irradiance: _Finite
    lights: _Finite
    moments: _Finite
    light_moments: _Finite


class _Fingerprint(TypedDict, total=False):
    """As in :mod:`gpf.scene.fingerprint`; earlier versions stored digests of all three."""

    geometry: str | Annotated[list[_Finite], Field(min_length=10, max_length=10)]
    materials: str | dict[str, _Finite]
    lights: str | list[str]


@with_config(ConfigDict(extra="allow"))
class _Record(TypedDict, total=False):
    fingerprint: _Fingerprint
    exposure: Positive
    passes: int
    estimated_psnr: float


class _Grid(TypedDict):
    width: Positive
    corner: _Vector


class _Lights(TypedDict):
    names: Annotated[list[str], Field(min_length=1)]
    members: list[list[Annotated[int, Field(ge=0)]]]


_Nothing = Annotated[dict[str, Any], Field(max_length=0)]


class FieldFacts(TypedDict, total=False):
    """The metadata of a field's file."""

    precision: str
    encoding: _Encoding
    settings: FieldSettings
    bounds: tuple[_Vector, _Vector]
    record: _Record
    grid: _Grid | _Nothing
    lights: _Lights | _Nothing
    volume: FieldFacts | _Nothing


# For each tensor: its shape with N Gaussians and G groups, its type, and its type if compact.
_SHAPES: dict[str, tuple[tuple[str | int, ...], str, str]] = {
    "means": (("N", 3), "f4", "u2"),
    "log_scales": (("N", 3), "f4", "u1"),
    "quats": (("N", 4), "f4", "i1"),
    "irradiance": (("N", 3), "f4", "f2"),
    "normals": (("N", 3), "f4", "i1"),
    "error": (("N",), "f4", "f2"),
    "caustics": (("N", 3), "f4", "f2"),
    "limits": (("N", 3, 3), "f4", "i1"),
    "limit_distances": (("N", 3), "f4", "f2"),
    "lights": (("G", "N", 3), "f4", "f2"),
    "moments": (("N", 2, 3, 4), "f4", "f2"),
    "light_moments": (("G", "N", 2, 3, 4), "f4", "f2"),
    "levels": (("N",), "u1", "u1"),
    "detail": (("X", "Y", "Z"), "u1", "u1"),
}
_ALWAYS = ("means", "log_scales", "quats", "irradiance", "normals")


def check_stored(
    path: Path,
    tensors: Mapping[str, np.ndarray],
    facts: Mapping[str, Any],
    precision: Literal["float32", "compact"],
) -> None:
    """Raise a :class:`FileError` if tensors are missing, have the wrong type, or do not match in
    size, or if metadata that belong to them are missing."""
    needed = [*_ALWAYS]
    needed += ["levels", "detail"] if facts.get("grid") else []
    needed += ["lights"] if facts.get("lights") else []
    needed += ["limit_distances"] if "limits" in tensors else []
    compact = precision == "compact"
    encoded = ["means", "log_scales", "irradiance"] + ["lights"] * ("lights" in needed)
    encoded += [name for name in ("moments", "light_moments") if name in tensors]
    keys = [("settings", facts), ("bounds", facts), ("record", facts)]
    keys += [(key, facts.get("encoding", {})) for key in encoded] if compact else []
    for key, among in keys:
        if key not in among:
            raise FileError(path, f"has no {key}")
    sizes: dict[str, int] = {"N": len(tensors.get("means", ()))}
    if facts.get("lights"):
        sizes["G"] = len(facts["lights"]["names"])
    wanted = {
        name: (shape, types[compact])
        for name, (shape, *types) in _SHAPES.items()
        if name in needed or name in tensors
    }
    require_shapes(path, tensors, wanted, sizes)
    if empty := next((name for name in wanted if not tensors[name].size), None):
        raise FileError(path, f"has no values in {empty}")


def smallest_search_radius(bounds: Any) -> float:
    """The smallest search radius of a field between two corners, world units."""
    # Twice the limit for files, so that a fitted field can be read again.
    return 2 * max(float(bounds[1][i] - bounds[0][i]) for i in range(3)) / _MOST_CELLS


def check_values(path: Path, tensors: Mapping[str, np.ndarray], facts: Mapping[str, Any]) -> None:
    """Raise a :class:`FileError` if the unpacked tensors have values that no field can have."""
    # Where no normals are compared, as in media, there may be none.
    directions = ("quats", "normals") if facts["settings"].get("normal_test", True) else ("quats",)
    least = {name: np.linalg.norm(tensors[name], axis=1).min() for name in directions}
    what = next((f"{name} of length 0" for name, length in least.items() if length < 1e-6), "")
    if np.abs(tensors["log_scales"]).max() > MOST_LOG_SCALE:
        what = "log_scales beyond the limits of single precision"
    extent = float(np.ptp(np.array(facts["bounds"]), axis=0).max())
    if facts.get("grid"):
        levels = int(tensors["detail"].max())
        extent = max(extent, facts["grid"]["width"] * max(tensors["detail"].shape)) * 2.0**levels
        if tensors["levels"].max() > levels:
            what = "levels that its table lacks"
    if (np.diff(facts["bounds"], axis=0) < 0).any():
        what = "bounds whose corners are swapped"
    if not extent <= _MOST_CELLS * facts["settings"]["search_radius"]:
        what = f"a search radius too small for its extent of {extent:.3g}"
    if facts.get("lights"):
        lights = facts["lights"]
        members = sorted(member for group in lights["members"] for member in group)
        if members != list(range(len(members))) or len(lights["names"]) != len(lights["members"]):
            what = "groups that do not hold each emitter once"
    if what:
        raise FileError(path, f"has {what}")
