"""Where on an image the points of a surface are: UVs, and the nodes that move them."""

from __future__ import annotations

import math

from sockets import Input, plain

Matrix = list[list[float]]


def read_mapping(place: Input) -> list[list[float]] | None:
    """The 2×3 matrix from the mesh's first UVs to the place in an image; None: something else."""
    found = place.origin()
    if found is None:
        return [[1, 0, 0], [0, 1, 0]]
    node, groups = found.node, found.groups
    if node.type == "UVMAP" and node.uv_map == "":
        return [[1, 0, 0], [0, 1, 0]]
    if node.type == "TEX_COORD" and found.socket.name == "UV" and not node.from_instancer:
        return [[1, 0, 0], [0, 1, 0]]
    if node.type == "MAPPING" and node.vector_type in ("POINT", "TEXTURE"):
        names = ("Location", "Rotation", "Scale")
        if any(
            Input(node.inputs[n], groups).origin() is not None for n in names if n in node.inputs
        ):
            return None
        inner = read_mapping(Input(node.inputs["Vector"], groups))
        location, rotation, scale = (plain(node.inputs[name]) for name in names)
        if inner is None or rotation[0] or rotation[1]:
            return None
        c, s = math.cos(rotation[2]), math.sin(rotation[2])
        own: Matrix = [
            [c * scale[0], -s * scale[1], location[0]],
            [s * scale[0], c * scale[1], location[1]],
        ]
        turned = _inverse(own) if node.vector_type == "TEXTURE" else own
        return None if turned is None else _product(turned, inner)
    return None


def _product(a: list[list[float]], b: list[list[float]]) -> list[list[float]]:
    full: Matrix = [*b, [0, 0, 1]]
    return [[sum(row[k] * full[k][j] for k in range(3)) for j in range(3)] for row in a]


def _inverse(m: list[list[float]]) -> list[list[float]] | None:
    (a, b, x), (c, d, y) = m
    det = a * d - b * c
    if det == 0:
        return None
    a, b, c, d = d / det, -b / det, -c / det, a / det
    return [[a, b, -a * x - b * y], [c, d, -c * x - d * y]]
