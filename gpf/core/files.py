"""Text, JSON and tensor files (safetensors with a schema version and metadata).

Writes are atomic: a reader sees the old file or the new one, never an incomplete one.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from gpf.core.errors import FileError, UserError

SCHEMA_VERSION = 1


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call ``write`` with the path of a temporary file beside ``path``, then rename that file.

    Folders are made as needed. Raises a :class:`UserError` if the file cannot be written.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # The same suffix as the file: some writers choose the format by it.
        handle, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".partial-{path.stem}-", suffix=path.suffix
        )
        os.close(handle)
        temporary = Path(name)
        write(temporary)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:  # RuntimeError: raised by image libraries
        raise UserError(
            str(path),
            f"could not be written ({error})",
            "Free some disk space or check the folder.",
        ) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_atomically(path, lambda p: p.write_text(text, encoding="utf-8"))


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically, sorted and indented, so that two files can be compared by line."""
    write_text(path, json.dumps(value, indent=2, sort_keys=True) + "\n")


def read_json(path: Path) -> Any:
    """Read JSON; a :class:`FileError` if the file is missing or is not JSON."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FileError(path, "is missing", missing=True) from error
    except json.JSONDecodeError as error:
        raise FileError(path, f"is not JSON ({error})") from error


def write_tensors(
    path: Path, kind: str, tensors: Mapping[str, np.ndarray], metadata: Mapping[str, Any]
) -> None:
    """Write named arrays atomically.

    Parameters
    ----------
    kind: what the file holds, e.g. ``targets``; :func:`read_tensors` asks for it.
    metadata: JSON values.
    """
    header = {
        "kind": kind,
        "schema_version": str(SCHEMA_VERSION),
        "metadata": json.dumps(dict(metadata), sort_keys=True),
    }
    arrays = {name: np.ascontiguousarray(value) for name, value in tensors.items()}
    data = _sort_header(save(arrays, metadata=header))
    write_atomically(path, lambda p: p.write_bytes(data))


def read_tensors(path: Path, kind: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the arrays and the metadata of a file of the given kind.

    Raises
    ------
    FileError: the file is missing, truncated, of another kind or of another schema version.
    """
    if not path.exists():
        raise FileError(path, "is missing", missing=True)
    try:
        with safe_open(str(path), framework="numpy") as file:
            header = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise FileError(path, f"is truncated or damaged ({error})") from error
    version = header.get("schema_version", "none")
    if header.get("kind") != kind:
        raise FileError(path, f"holds {header.get('kind', 'something else')}, not {kind}")
    if version != str(SCHEMA_VERSION):
        raise FileError(path, f"has schema version {version}; this program reads {SCHEMA_VERSION}")
    return tensors, json.loads(header["metadata"])


def _sort_header(data: bytes) -> bytes:
    """Sort the keys in the header of a safetensors file.

    The library writes them in an order that changes from run to run, so that the same content
    would be a change for DVC.
    """
    end = 8 + int.from_bytes(data[:8], "little")
    header = json.dumps(json.loads(data[8:end]), sort_keys=True, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)  # keeps the tensors aligned
    return len(header).to_bytes(8, "little") + header + data[end:]
