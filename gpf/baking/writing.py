"""The files of a bake: maps as EXR and PNG, and meshes as PLY."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gpf.baking.bake import LightMaps, LitVertices
from gpf.baking.surfaces import Surface
from gpf.core.images import tone_map, write_exr, write_png
from gpf.core.ply import write_ply


def write_maps(folder: Path, baked: LightMaps, exposure: float) -> dict[str, Any]:
    """Write ``light.exr`` and ``light.png``, ``light_GROUP.exr`` and ``.png`` for each group of
    lights, and a mesh for each surface; return what they are, as JSON values.

    The PNG files show a white surface in this light: E / π, tone mapped.
    """
    maps = {}
    for group, irradiance in baked.maps.items():
        stem = f"light_{group}" if group else "light"
        record = {"quantity": "irradiance, W/m²", "lights": group or "all"}
        write_exr(folder / f"{stem}.exr", {"radiance": irradiance}, record)
        write_png(folder / f"{stem}.png", irradiance / np.pi, exposure)
        maps[group] = {"irradiance": f"{stem}.exr", "preview": f"{stem}.png"}
    charts, size = baked.atlas.charts, list(baked.atlas.size)
    shapes = {}
    for chart, file in zip(charts, _files([chart.surface for chart in charts]), strict=True):
        geometry = _geometry(chart.surface, chart.vertices)
        write_ply(folder / file, {**geometry, "u v": chart.uv}, chart.faces)
        map_file = maps[""]["irradiance"]
        shapes[chart.surface.name] = {"mesh": file, "map": map_file, "size": size}
    return {"light": maps.pop(""), "groups": maps, "shapes": shapes}


def write_vertices(folder: Path, lit: Sequence[LitVertices], exposure: float) -> dict[str, Any]:
    """Write a mesh for each surface, with the irradiance at its vertices, W/m², and a colour that
    shows it: E / π, tone mapped. Return what the files are, as JSON values."""
    shapes = {}
    for part, file in zip(lit, _files([part.surface for part in lit]), strict=True):
        columns = _geometry(part.surface, part.vertices)
        shown = np.round(255 * tone_map(part.light[""] / np.pi, exposure)).astype(np.uint8)
        columns["red green blue"] = shown
        for group, light in part.light.items():
            stem = f"irradiance_{group}" if group else "irradiance"
            columns[f"{stem}_r {stem}_g {stem}_b"] = light
        write_ply(folder / file, columns, part.faces)
        shapes[part.surface.name] = {"mesh": file}
    groups = [group for group in lit[0].light if group]
    return {"groups": groups, "shapes": shapes}


def _geometry(surface: Surface, vertices: np.ndarray) -> dict[str, np.ndarray]:
    columns = {"x y z": surface.points[vertices]}
    if surface.normals is not None:
        columns["nx ny nz"] = surface.normals[vertices]
    return columns


def _files(surfaces: Iterable[Surface]) -> list[str]:
    """Names for the meshes, even where file systems do not distinguish capitals."""
    files: list[str] = []
    for surface in surfaces:
        stem = plain = re.sub(r"[^A-Za-z0-9_-]+", "_", surface.name)[:100]
        number = 1
        while any(f"{stem}.ply".lower() == file.lower() for file in files):
            number += 1
            stem = f"{plain}_{number}"
        files.append(f"{stem}.ply")
    return files
