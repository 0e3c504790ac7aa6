"""EXR files, tone mapping and PNG previews."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from gpf.core.errors import FileError, UserError
from gpf.core.files import SCHEMA_VERSION, Parts, checksum, write_atomically

# The header attributes that hold the record (how the image was made) and the checksum.
_RECORD, _CHECKSUM = "gpf", "gpf_checksum"


def write_exr(path: Path, layers: Mapping[str, np.ndarray], record: Mapping[str, Any]) -> None:
    """Write layers to one EXR, atomically.

    Parameters
    ----------
    layers: name to float array, (H, W, 3) or (H, W). The layer ``radiance`` becomes the channels
        R, G, B, which every viewer shows. Another layer ``x`` becomes x.R, x.G, x.B, or x.V if it
        has a single channel.
    record: how the image was made; JSON values.
    """
    channels: dict[str, np.ndarray] = {}
    for name, value in layers.items():
        array = np.ascontiguousarray(value, dtype=np.float32)
        if array.ndim == 2:
            channels[f"{name}.V"] = array
            continue
        prefix = "" if name == "radiance" else f"{name}."
        for i, letter in enumerate("RGB"):
            channels[prefix + letter] = np.ascontiguousarray(array[..., i])
    text = json.dumps({"schema_version": SCHEMA_VERSION, **record}, sort_keys=True)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        _RECORD: text,
        _CHECKSUM: checksum(text, channels),
    }

    def write(temporary: Path) -> None:
        OpenEXR.File(header, channels).write(str(temporary))
        try:  # OpenEXR does not report a file truncated by a full disk
            _read_channels(temporary)
        except FileError as error:
            raise OSError("the disk may be full") from error

    write_atomically(path, write)


def read_exr(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Layers and record of an EXR, (H, W, 3) or (H, W) float32.

    Raises
    ------
    FileError: the file is missing, truncated, damaged or of another schema version. Accessing a
        layer that the file does not have also raises a FileError.
    """
    channels, record = _read_channels(path)
    if record.get("schema_version") != SCHEMA_VERSION:
        version = record.get("schema_version", "none")
        raise FileError(path, f"has schema version {version}; this program reads {SCHEMA_VERSION}")
    layers = Parts(path, "layer")
    for name, pixels in channels.items():
        layer, _, letter = name.rpartition(".")
        if letter == "V":
            layers[layer] = pixels
        elif letter == "R":
            prefix = f"{layer}." if layer else ""
            layers[layer or "radiance"] = np.stack([channels[prefix + c] for c in "RGB"], -1)
    return layers, record


def _read_channels(path: Path) -> tuple[Parts, dict[str, Any]]:
    """Channels and record of an EXR, which must be complete."""
    if not path.exists():
        raise FileError(path, "is missing", missing=True)
    channels = Parts(path, "channel")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            header = dict(file.header())  # a copy: the file empties its own when it is closed
            text = header.get(_RECORD, "{}")
            record: dict[str, Any] = dict(json.loads(text))
            channels |= {name: c.pixels.copy() for name, c in file.channels().items()}
    except Exception as error:  # OpenEXR raises several built-in exceptions
        raise FileError(path, f"is truncated or not an EXR ({error})") from error
    # OpenEXR only prints a warning if pixels cannot be read. Older files have no checksum.
    if header.get(_CHECKSUM, found := checksum(text, channels)) != found:
        raise FileError(path, "is truncated or damaged (its content does not match its checksum)")
    return channels, record


def read_record(path: Path) -> dict[str, Any] | None:
    """The record of an EXR (see :func:`write_exr`); None if the file cannot be read."""
    if not path.exists():
        return None
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            return dict(json.loads(file.header().get(_RECORD, "{}")))
    except Exception:  # no permission, truncated, another format
        return None


def check_finite(image: np.ndarray, where: str) -> None:
    """Raise a :class:`UserError` if an image (H, W, 3) or points (N, 3) have non-finite values."""
    broken = ~np.isfinite(image).all(axis=-1)
    if broken.any():
        first = np.argwhere(broken)[0]
        image = broken.ndim == 2
        place = f"x={first[1]}, y={first[0]}" if image else f"number {first[0]}"
        kind = "pixels" if image else "points"
        raise UserError(
            where,
            f"{int(broken.sum())} of {broken.size} {kind} are NaN or infinite, the first at "
            f"{place}",
            "Look for a zero-area emitter, a mesh with broken normals or a material with an "
            "albedo above one.",
        )


def propose_exposure(radiance: np.ndarray) -> float:
    """The exposure at which 90 % of the pixels (..., 3) are below 0.8 of display white."""
    bright = float(np.quantile(np.asarray(radiance) @ [0.2126, 0.7152, 0.0722], 0.9))
    return 0.8 / bright if bright > 0 else 1.0


def tone_map(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """Linear radiance to sRGB values in [0, 1]: exposure, clipping to [0, 1], sRGB curve."""
    linear = np.clip(np.asarray(radiance, dtype=np.float64) * exposure, 0, 1)
    curved = 1.055 * np.power(np.maximum(linear, 1e-12), 1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curved)


def tone_slope(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """The derivative of :func:`tone_map` with respect to radiance; 0 where it clips."""
    linear = np.asarray(radiance, dtype=np.float64) * exposure
    curved = 1.055 / 2.4 * np.power(np.clip(linear, 0.0031308, 1), 1 / 2.4 - 1)
    slope = np.where(linear <= 0.0031308, 12.92, curved)
    return np.where((linear >= 0) & (linear < 1), exposure * slope, 0)


def tone_secant(x: np.ndarray, y: np.ndarray, exposure: float) -> np.ndarray:
    """(T(x) - T(y)) / (x - y) with T as in :func:`tone_map`; the derivative where x equals y.

    For large differences, the derivative at x would be wrong, because clipped light does not show.
    """
    step = y - x
    near = np.abs(step) <= 1e-3 * np.maximum(np.abs(x), 1e-6)
    shown = tone_map(y, exposure) - tone_map(x, exposure)
    return np.where(near, tone_slope(x, exposure), shown / np.where(near, 1, step))


def undo_tone_map(srgb: np.ndarray) -> np.ndarray:
    """Convert sRGB values, clipped to [0, 1], to linear radiance times exposure."""
    value = np.clip(np.asarray(srgb, dtype=np.float64), 0, 1)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def write_png(path: Path, radiance: np.ndarray, exposure: float) -> None:
    """Write a tone-mapped PNG atomically, 8 bits per channel."""
    import mitsuba as mi

    pixels = np.round(tone_map(radiance, exposure) * 255).astype(np.uint8)
    # Via memory: Mitsuba does not report a file truncated by a full disk.
    stream = mi.MemoryStream()
    mi.Bitmap(pixels).write(stream, mi.Bitmap.FileFormat.PNG)
    write_atomically(path, lambda p: p.write_bytes(stream.raw_buffer()))
