"""Text, JSON and tensor files (safetensors with a schema version, metadata and a checksum).

Writes are atomic: a reader sees the old file or the new one, never an incomplete one.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from gpf.core.errors import FileError, WriteError
from gpf.core.partial import grant_as_usual, partial_file

SCHEMA_VERSION = 1

LARGEST_HEADER = 16 << 20
"""Maximum size of a tensor file's header, bytes; this program writes a few thousand."""


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call ``write`` with the path of a temporary file beside ``path``, then rename that file.

    Folders are created as needed. Raises a :class:`WriteError` if the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial_file(path) as temporary:
            write(temporary)
            grant_as_usual(temporary)
            os.replace(temporary, path)
    except (OSError, RuntimeError) as error:  # RuntimeError: raised by image libraries
        raise WriteError(path, error) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_atomically(path, lambda p: p.write_text(text, encoding="utf-8"))


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically, sorted and indented, so that files can be compared line by line."""
    write_text(path, json.dumps(value, indent=2, sort_keys=True) + "\n")


def read_json(path: Path, shape: Any = Any) -> Any:
    """Read JSON.

    Parameters
    ----------
    shape: type that the content must have, such as ``dict[str, float]``; nothing is converted.

    Raises
    ------
    FileError: the file is missing, is not JSON, or does not have this shape.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise FileError(path, "is missing", missing=True) from error
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror})") from error
    return _parse_json(path, data, shape)


def _parse_json(path: Path, text: str | bytes, shape: Any) -> Any:
    """Parse the content of a file, or part of it."""
    try:
        text = text.decode("utf-8") if isinstance(text, bytes) else text
        content = json.loads(text)
        TypeAdapter(shape).validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the whole file"
        raise FileError(path, f"has the wrong structure ({place}: {first['msg']})") from error
    # ValueError: not UTF-8, not JSON, a number with thousands of digits. RecursionError: too deep.
    except (ValueError, RecursionError) as error:
        raise FileError(path, f"is not JSON ({error})") from error
    return content


def write_tensors(
    path: Path, kind: str, tensors: Mapping[str, np.ndarray], metadata: Mapping[str, Any]
) -> None:
    """Write named arrays atomically.

    Parameters
    ----------
    kind: what the file holds, e.g. ``targets``; :func:`read_tensors` checks it.
    metadata: JSON values.
    """
    arrays = {name: np.ascontiguousarray(value) for name, value in tensors.items()}
    text = json.dumps(dict(metadata), sort_keys=True)
    header = {
        "kind": kind,
        "schema_version": str(SCHEMA_VERSION),
        "metadata": text,
        "checksum": checksum(text, arrays),
    }
    data = _sort_header(save(arrays, metadata=header))
    write_atomically(path, lambda p: p.write_bytes(data))


def read_tensors(
    path: Path, kind: str, shape: Any = dict[str, Any]
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the arrays and the metadata of a file of the given kind.

    ``shape``: type of the metadata, as for :func:`read_json`.

    Raises
    ------
    FileError: the file is missing, truncated, damaged, of another kind or of another schema
        version, or its metadata are not JSON or do not have the given shape. Accessing an array
        that the file does not have also raises a FileError.
    """
    if not path.exists():
        raise FileError(path, "is missing", missing=True)
    try:
        _check_header_size(path)
        with safe_open(str(path), framework="numpy") as file:
            header = file.metadata() or {}
            tensors = Parts(path, "tensor")
            tensors |= {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    # Besides the library's own errors: a type that numpy lacks, or a header nested too deep.
    except (SafetensorError, OSError, ValueError, TypeError, AttributeError, KeyError) as error:
        raise FileError(path, f"is truncated or damaged ({error})") from error
    version, text = header.get("schema_version", "none"), header.get("metadata", "")
    if header.get("kind") != kind:
        raise FileError(path, f"holds {header.get('kind', 'something else')}, not {kind}")
    if version != str(SCHEMA_VERSION):
        raise FileError(path, f"has schema version {version}; this program reads {SCHEMA_VERSION}")
    # Older files have no checksum.
    if header.get("checksum", found := checksum(text, tensors)) != found:
        raise FileError(path, "is damaged (its content does not match its checksum)")
    return tensors, _parse_json(path, text, shape)


def name_not_finite(tensors: Mapping[str, np.ndarray]) -> str | None:
    """The name of the first tensor with a NaN or infinite value, or None."""
    return next((name for name, value in tensors.items() if not np.isfinite(value).all()), None)


def require_finite(path: Path, tensors: Mapping[str, np.ndarray]) -> None:
    """Raise a :class:`FileError` if any tensor of a file has NaN or infinite values."""
    if name := name_not_finite(tensors):
        raise FileError(path, f"has NaN or infinite values in {name}")


def require_shapes(
    path: Path,
    tensors: Mapping[str, np.ndarray],
    wanted: Mapping[str, tuple[tuple[str | int, ...], str]],
    sizes: Mapping[str, int] | None = None,
) -> None:
    """Raise a :class:`FileError` if tensors of a file are missing or have the wrong shape or type.

    Parameters
    ----------
    wanted: name -> shape and type, such as ``(("N", 3), "f4")``. A letter stands for the same size
        everywhere.
    sizes: sizes that are already known, by letter.
    """
    known = dict(sizes or {})
    for name, (shape, kind) in wanted.items():
        if name not in tensors:
            raise FileError(path, f"has no tensor {name}")
        value = tensors[name]
        fits = value.ndim == len(shape) and all(
            size == (known.setdefault(n, size) if isinstance(n, str) else n)
            for n, size in zip(shape, value.shape, strict=True)
        )
        if not fits or value.dtype != np.dtype(kind):
            dims = ", ".join(str(known.get(n, n) if isinstance(n, str) else n) for n in shape)
            raise FileError(
                path, f"has {name} of shape {value.shape}, {value.dtype}, not ({dims}), {kind}"
            )


def require_scene(path: Path, metadata: Mapping[str, Any], scene: str) -> None:
    """Raise a :class:`FileError` if a file says that it belongs to another scene; files of earlier
    versions do not say."""
    if (found := metadata.get("scene", scene)) != scene:
        raise FileError(path, f"belongs to the scene {found}, not to {scene}")


class Parts(dict[str, np.ndarray]):
    """The arrays of a file; accessing one that it does not have raises a :class:`FileError`.

    Parameters
    ----------
    kind: what an array is called in the message.
    """

    def __init__(self, path: Path, kind: str) -> None:
        super().__init__()
        self.path, self.kind = path, kind

    def __missing__(self, name: str) -> np.ndarray:
        raise FileError(self.path, f"has no {self.kind} {name}")


def checksum(text: str, arrays: Mapping[str, np.ndarray]) -> str:
    """CRC-32 of a text and of named arrays with their shapes; their order does not matter."""
    value = zlib.crc32(text.encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        value = zlib.crc32(f"{name} {array.dtype.str} {array.shape}".encode(), value)
        value = zlib.crc32(array.reshape(-1).view(np.uint8).data, value)
    return f"{value:08x}"


def _check_header_size(path: Path) -> None:
    """Raise an OSError if the header is larger than the file or than :data:`LARGEST_HEADER`."""
    with path.open("rb") as file:
        size = int.from_bytes(file.read(8), "little")
    if size > min(LARGEST_HEADER, path.stat().st_size - 8):
        raise OSError(f"its header would have {size} bytes")


def _sort_header(data: bytes) -> bytes:
    """Sort the keys in the header of a safetensors file.

    The library writes them in an order that changes from run to run, so DVC would see a change
    where the content is the same.
    """
    end = 8 + int.from_bytes(data[:8], "little")
    header = json.dumps(json.loads(data[8:end]), sort_keys=True, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)  # keeps the tensors aligned
    return len(header).to_bytes(8, "little") + header + data[end:]
