"""A description (:mod:`baselines.translation.description`) as a scene file of LuxCore."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from baselines.luxcore.materials import Materials
from baselines.luxcore.properties import Properties, colour, matrix, to_text
from baselines.translation.meshes import face_along_normals, tessellate
from gpf.core.files import write_text
from gpf.core.images import write_exr
from gpf.core.ply import write_ply
from gpf.modelling.meshes import Mesh

SPOT_ROWS = 256
"""Rows of the map of all directions that stands for a spot, as many as LuxCore itself looks at."""

PROJECTOR_ROWS = 512

BALL = (48, 24)
"""Steps around and along a sphere that shines."""


def write_scene(description: Mapping[str, Any], folder: Path, where: str) -> Path:
    """Write ``scene.scn`` and the files that it names into the folder of a description.

    Raises
    ------
    CannotServe: LuxCore cannot express something in the scene.
    """
    materials = Materials(folder, where)
    found: Properties = {}
    names: dict[str, str] = {}
    for number, shape in enumerate(description["shapes"]):
        radiance = shape.get("radiance")
        key = f"{shape['material']} {radiance}"
        if key not in names:
            names[key] = materials.add(description["materials"][shape["material"]], radiance)
        thing: Properties = {"ply": _mesh(folder, shape, number), "material": names[key]}
        if shape["matrix"] is not None and not _mirrors(shape["matrix"]):
            thing["transformation"] = matrix(shape["matrix"])
        found |= _named("objects", f"object_{number}", thing)
    for number, lamp in enumerate(description["lamps"]):
        found |= _named("lights", f"lamp_{number}", _lamp(lamp, materials, folder))
    path = folder / "scene.scn"
    write_text(path, to_text(materials.properties | found))
    return path


def _named(kind: str, name: str, found: Properties) -> Properties:
    return {f"scene.{kind}.{name}.{key}": value for key, value in found.items()}


def _mirrors(placed: Any) -> bool:
    return float(np.linalg.det(np.array(placed)[:3, :3])) < 0


def _mesh(folder: Path, shape: Mapping[str, Any], number: int) -> str:
    """A mesh as PLY."""
    path = (folder / shape["mesh"]).with_suffix(".ply")
    mirrored = shape["matrix"] is not None and _mirrors(shape["matrix"])
    if mirrored:
        path = path.with_name(f"{path.stem}_mirrored_{number}.ply")
    if path.exists():
        return str(path)
    with np.load(folder / shape["mesh"]) as arrays:
        found = Mesh(*(arrays.get(name) for name in ("points", "faces", "normals", "uv")))
    if "radiance" in shape and shape["outline"] == "sphere":
        # Each triangle is a lamp of its own, and one of them is chosen for a sample.
        ball = tessellate("Sphere", *BALL).transformed(np.array(shape["placed"]))
        found = face_along_normals(ball)
    if mirrored:  # LuxCore would turn it inside out
        found = replace(found.transformed(np.array(shape["matrix"])), faces=found.faces[:, ::-1])
    # LuxCore's names for texture coordinates are s and t.
    columns = {"x y z": found.points, "nx ny nz": found.normals, "s t": found.uv}
    write_ply(path, {k: v for k, v in columns.items() if v is not None}, found.faces)
    return str(path)


def _lamp(lamp: Mapping[str, Any], materials: Materials, folder: Path) -> Properties:
    kind = lamp["kind"]
    if kind == "point":
        gain = [4 * math.pi * c for c in colour(lamp["intensity"])]
        return {"type": "point", "position": lamp["position"], "gain": gain}
    if kind == "directional":
        gain = colour(lamp["irradiance"])
        return {"type": "sharpdistant", "direction": lamp["direction"], "gain": gain}
    if kind == "constant":
        return {"type": "constantinfinite", "gain": colour(lamp["radiance"])}
    if kind == "envmap":
        return _sky(lamp, materials)
    if kind == "spot":
        return _spot(lamp, folder)
    return _projector(lamp, materials)


def _axes(lamp: Mapping[str, Any]) -> np.ndarray:
    """The matrix of a lamp without its scale."""
    found = np.array(lamp["matrix"], dtype=float)
    found[:3, :3] /= np.linalg.norm(found[:3, :3], axis=0)
    return found


def _sky(lamp: Mapping[str, Any], materials: Materials) -> Properties:
    """LuxCore's maps begin at +x, and the top is +z; columns go the other way round."""
    turned = np.zeros((4, 4))
    turned[0, 2] = turned[1, 0] = -1
    turned[2, 1] = turned[3, 3] = 1
    return {
        "type": "infinite",
        "file": materials.file(lamp["image"], flipped=True),
        "gamma": 1.0,
        "storage": "float",
        "transformation": matrix(_axes(lamp) @ turned.T),
    }


def _spot(lamp: Mapping[str, Any], folder: Path) -> Properties:
    """A point with a map of its intensities: LuxCore's own spots have another curve."""
    angle = np.pi * (np.arange(SPOT_ROWS) + 0.5) / SPOT_ROWS
    fall = max(lamp["cutoff"] - lamp["beam"], 1e-6)
    left = np.clip((lamp["cutoff"] - angle) / fall, 0, 1)
    path = folder / f"spot_{lamp['cutoff']:.6f}_{lamp['beam']:.6f}.exr"
    write_exr(path, {"radiance": np.tile(left[:, None, None], (1, 4, 3)).astype(np.float32)}, {})
    # LuxCore divides by the map's integral over all directions.
    whole = 4 * math.pi * float((left * np.sin(angle)).sum() / np.sin(angle).sum())
    return {
        "type": "mappoint",
        "mapfile": str(path),
        "gamma": 1.0,
        "position": [0.0, 0.0, 0.0],
        "gain": [4 * math.pi * whole * c for c in colour(lamp["intensity"])],
        "transformation": matrix(_axes(lamp)),
    }


def _projector(lamp: Mapping[str, Any], materials: Materials) -> Properties:
    """LuxCore's has the same intensity in all directions, and its image begins elsewhere."""
    width, height = lamp["size"]
    turned = np.eye(4)
    turned[:2, :2] = [[0, -1], [1, 0]]
    path = materials.folder / "projector.exr"
    write_exr(path, {"radiance": _intensities(lamp, materials.folder)}, {})
    return {
        "type": "projection",
        "position": [0.0, 0.0, 0.0],
        "target": [0.0, 0.0, 1.0],
        "fov": math.degrees(2 * math.atan(min(width, height) / 2)),
        "transformation": matrix(_axes(lamp) @ turned),
        "mapfile": str(path),
        "gamma": 1.0,
        "storage": "float",
        "gain": [1.0, 1.0, 1.0],
        "normalizebycolor": False,
    }


def _intensities(lamp: Mapping[str, Any], folder: Path) -> np.ndarray:
    """E / cos³ in the pixels of a projector's image, (H, W, 3); LuxCore begins it below."""
    width, height = lamp["size"]
    rows = PROJECTOR_ROWS
    columns = max(round(rows * width / height), 1)
    v, u = ((np.arange(n) + 0.5) / n for n in (rows, columns))
    irradiance = lamp["irradiance"]
    if isinstance(irradiance, dict):
        pixels = np.load(folder / irradiance["image"])
        place = np.meshgrid(v * pixels.shape[0] - 0.5, u * pixels.shape[1] - 0.5, indexing="ij")
        mode = "grid-wrap" if irradiance["wrap"] == "repeat" else "nearest"
        found = [map_coordinates(c, place, order=1, mode=mode) for c in pixels.transpose(2, 0, 1)]
    else:
        found = [np.full((rows, columns), c) for c in colour(irradiance)]
    x, y = (u - 0.5) * width, (v - 0.5) * height
    cosine = 1 / np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
    return np.stack([c / cosine**3 for c in found], axis=-1)[::-1].astype(np.float32)
