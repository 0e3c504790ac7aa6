"""Binary glTF 2.0: a JSON text and one buffer."""

from __future__ import annotations

import io
import json
import struct
from typing import Any

import numpy as np
from PIL import Image

Json = dict[str, Any]

_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}
_TYPES = {"float32": 5126, "uint32": 5125}
_VERTICES, _INDICES = 34962, 34963

CLAMP = 33071

JPEG_QUALITY = 95


class Glb:
    """A file in the making.

    Attributes
    ----------
    content: the JSON text's lists, such as ``nodes``.
    """

    def __init__(self, generator: str) -> None:
        self.content: Json = {"asset": {"version": "2.0", "generator": generator}}
        self._extensions: set[str] = set()
        self._buffer = bytearray()

    def add(self, kind: str, value: Json) -> int:
        """Add to one of the lists, and return the index."""
        self._extensions |= value.get("extensions", {}).keys()
        listed = self.content.setdefault(kind, [])
        listed.append(value)
        return len(listed) - 1

    def vertices(self, values: np.ndarray, bounds: bool = False) -> int:
        """Add a property of vertices, (V, K) float32; return its accessor."""
        accessor = self._accessor(values.astype(np.float32), _VERTICES)
        if bounds:
            low, high = values.min(axis=0), values.max(axis=0)
            accessor |= {"min": low.tolist(), "max": high.tolist()}
        return self.add("accessors", accessor)

    def indices(self, faces: np.ndarray) -> int:
        """Add triangles, (M, 3); return their accessor."""
        flat = faces.astype(np.uint32).reshape(-1, 1)
        return self.add("accessors", self._accessor(flat, _INDICES))

    def texture(self, pixels: np.ndarray, wrap: int = CLAMP) -> int:
        """Add an image, (H, W, 3) uint8, as PNG or JPEG, whichever is smaller; return its texture.

        Parameters
        ----------
        wrap: glTF's number for what is beyond its edges; by default, the colour of the edge.
        """
        data, kind = encode(pixels)
        image = self.add("images", {"bufferView": self._view(data), "mimeType": kind})
        smooth = {"wrapS": wrap, "wrapT": wrap, "magFilter": 9729, "minFilter": 9987}
        return self.add("textures", {"source": image, "sampler": self.add("samplers", smooth)})

    def to_bytes(self) -> bytes:
        """The whole file."""
        content = {**self.content, "buffers": [{"byteLength": len(self._buffer)}]}
        if self._extensions:
            content["extensionsUsed"] = sorted(self._extensions)
        text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
        chunks = b""
        for kind, data, filler in ((b"JSON", text, b" "), (b"BIN\0", bytes(self._buffer), b"\0")):
            data += filler * (-len(data) % 4)
            chunks += struct.pack("<I4s", len(data), kind) + data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _accessor(self, values: np.ndarray, target: int) -> Json:
        return {
            "bufferView": self._view(values.tobytes(), target),
            "componentType": _TYPES[values.dtype.name],
            "type": _KINDS[values.shape[1]],
            "count": len(values),
        }

    def _view(self, data: bytes, target: int | None = None) -> int:
        self._buffer += b"\0" * (-len(self._buffer) % 4)
        view: Json = {"buffer": 0, "byteOffset": len(self._buffer), "byteLength": len(data)}
        self._buffer += data
        return self.add("bufferViews", view if target is None else {**view, "target": target})


def encode(pixels: np.ndarray) -> tuple[bytes, str]:
    """An image, (H, W, 3) uint8, as PNG or JPEG, whichever is smaller, and its media type."""
    files = []
    for kind, options in (("png", {}), ("jpeg", {"quality": JPEG_QUALITY, "subsampling": 0})):
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, kind, **options)
        files.append((file.getvalue(), f"image/{kind}"))
    return min(files, key=lambda file: len(file[0]))
