"""Binary glTF, read as the specification says."""

from __future__ import annotations

import io
import json
import struct

import numpy as np
from PIL import Image

TYPES = {5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}


class Read:
    """The JSON text and the buffer of a file."""

    def __init__(self, data: bytes) -> None:
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON" and size % 4 == 0
        self.content = json.loads(data[20 : 20 + size])
        rest, kind = struct.unpack_from("<I4s", data, 20 + size)
        assert kind == b"BIN\0" and rest % 4 == 0 and 28 + size + rest == len(data)
        self.buffer = data[28 + size :]
        assert 0 <= rest - self.content["buffers"][0]["byteLength"] < 4

    def view(self, index: int) -> bytes:
        view = self.content["bufferViews"][index]
        assert view["byteOffset"] % 4 == 0
        end = view["byteOffset"] + view["byteLength"]
        assert end <= self.content["buffers"][0]["byteLength"]
        return self.buffer[view["byteOffset"] : end]

    def values(self, index: int) -> np.ndarray:
        accessor = self.content["accessors"][index]
        values = np.frombuffer(self.view(accessor["bufferView"]), TYPES[accessor["componentType"]])
        values = values.reshape(accessor["count"], WIDTHS[accessor["type"]])
        for name, bound in (("min", values.min(axis=0)), ("max", values.max(axis=0))):
            np.testing.assert_array_equal(accessor.get(name, bound), bound)
        return values

    def image(self, texture: dict) -> np.ndarray:
        source = self.content["textures"][texture["index"]]["source"]
        image = self.content["images"][source]
        with Image.open(io.BytesIO(self.view(image["bufferView"]))) as opened:
            assert image["mimeType"] == f"image/{opened.format.lower()}"
            return np.asarray(opened)

    def part(self, name: str) -> tuple[dict[str, np.ndarray], np.ndarray, dict]:
        """The properties of a mesh's vertices, its triangles and its material."""
        (node,) = (n for n in self.content["nodes"] if n["name"] == name)
        (primitive,) = self.content["meshes"][node["mesh"]]["primitives"]
        attributes = {k: self.values(v) for k, v in primitive["attributes"].items()}
        faces = self.values(primitive["indices"]).reshape(-1, 3)
        assert faces.max() < len(attributes["POSITION"])
        return attributes, faces, self.content["materials"][primitive["material"]]
