"""The compact precision of field files: a third of the size.

Tensors are stored as follows, with these largest errors:

============  ==========================================================  ====================
means         uint16 steps between minimum and maximum, per axis          1/131,000 of the range
log_scales    uint8 steps likewise, limited to :data:`SCALES` radii       2% of a scale
quats         int8 steps of 1/127 of the longest component; unit length   half a degree
irradiance    float16 in a unit that makes the maximum at least 2^14      0.05%, over 8 orders
lights        as irradiance                                               0.05%, over 8 orders
moments       as irradiance                                               0.05%, over 8 orders
normals       as quats                                                    half a degree
error         float16                                                     0.05%
caustics      float16                                                     0.05%
limits        as quats; distances float16                                 half a degree, 0.05%
============  ==========================================================  ====================

A Gaussian takes 22 bytes instead of 64; 37 instead of 112 in a field with limits. A field
read from a compact file gives the same bytes when written again.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gpf.core.vectors import normalise

# Range of standard deviations in a compact file, in search radii of their level. A query uses
# distances up to about one radius; on that scale, smaller Gaussians are points and larger ones
# constant.
SCALES = (0.0025, 50.0)


def pack(
    tensors: Mapping[str, np.ndarray], radius: float
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The tensors of a compact file, and the ranges and units needed to read them."""
    finest = int(tensors["levels"].max()) if "levels" in tensors else 0
    least, most = SCALES
    sizes = np.log([least * radius / 2**finest, most * radius]).astype(np.float32)
    limited = {**tensors, "log_scales": np.clip(tensors["log_scales"], *sizes)}
    packed, encoding = {}, {}
    for name, (pack_values, _) in _METHODS.items():
        if name in tensors:
            packed[name], facts = pack_values(limited[name])
            if facts is not None:
                encoding[name] = facts
    return packed, encoding


def unpack(tensors: Mapping[str, np.ndarray], encoding: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The inverse of :func:`pack`, but for what it rounds."""
    return {
        name: unpack_values(tensors[name], encoding.get(name))
        for name, (_, unpack_values) in _METHODS.items()
        if name in tensors
    }


def _to_steps(values: np.ndarray, kind: type[np.unsignedinteger]) -> tuple[np.ndarray, Any]:
    """Columns (N, D) as integer steps of their ranges, and the ranges."""
    least, greatest = values.min(axis=0).astype(float), values.max(axis=0).astype(float)
    width = np.where(greatest > least, greatest - least, 1)
    steps = np.rint((values - least) / width * np.iinfo(kind).max).astype(kind)
    return steps, [least.tolist(), greatest.tolist()]


def _from_steps(steps: np.ndarray, ranges: Any) -> np.ndarray:
    """Values from steps. The ends of a range are exact, so that packing again gives the same
    range."""
    least, greatest = np.asarray(ranges)
    share = steps / np.iinfo(steps.dtype).max
    return (least * (1 - share) + greatest * share).astype(np.float32)


def _to_bytes(vectors: np.ndarray) -> tuple[np.ndarray, None]:
    """Directions (..., D) of any length as int8; zero stays zero."""
    longest = np.abs(vectors).max(axis=-1, keepdims=True).astype(float)
    return np.rint(127 * (vectors / np.where(longest > 0, longest, 1))).astype(np.int8), None


def _from_bytes(codes: np.ndarray, _: None) -> np.ndarray:
    """Directions of unit length."""
    return normalise(codes.astype(float)).astype(np.float32)


def _to_halves(values: np.ndarray) -> tuple[np.ndarray, float]:
    """Values in a unit as float16, and the unit: a power of two, which changes no digit.

    The maximum becomes 2^14 to 2^15. Half precision has all digits down to 2^-14 and some digits
    down to 2^-24: eight and eleven orders of magnitude below the maximum.
    """
    mantissa, exponent = np.frexp(float(np.abs(values).max()))
    # If rounding gives the next power of two, use its unit, so that packing again uses it too.
    unit = 2.0 ** (int(exponent) + int(np.float16(mantissa) == 1) - 15)
    return (values / unit).astype(np.float16), unit


def _from_halves(values: np.ndarray, unit: float) -> np.ndarray:
    return (values * np.float64(unit)).astype(np.float32)


_directions = _to_bytes, _from_bytes
_light = _to_halves, _from_halves
_rounded = lambda v: (v.astype(np.float16), None), lambda v, _: v.astype(np.float32)
_exact = lambda v: (v, None), lambda v, _: v

# How each tensor is packed and unpacked.
_METHODS: Mapping[str, tuple[Any, Any]] = {
    "means": (lambda v: _to_steps(v, np.uint16), _from_steps),
    "log_scales": (lambda v: _to_steps(v, np.uint8), _from_steps),
    "quats": _directions,
    "irradiance": _light,
    "normals": _directions,
    "levels": _exact,
    "detail": _exact,
    "lights": _light,
    "moments": _light,
    "light_moments": _light,
    "error": _rounded,
    "caustics": _rounded,
    "limits": _directions,
    "limit_distances": _rounded,
}
