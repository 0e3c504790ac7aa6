"""The package xatlas in a process of its own: it cuts meshes into charts, and packs them on a page.

An atlas that is destroyed waits for its threads, and xatlas may fail to wake them: once in some
thousand times it waits forever. This process ends without destroying any.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from gpf.core.errors import UserError
from gpf.core.subprocesses import last_line

PADDING = 4
"""Texels between charts: each has two around it of its own."""

# Twice xatlas's own: a third of the charts on a teapot's lid, and no more distortion.
MAX_COST = 4.0

AT_ONCE = 64
"""Most meshes that a process cuts: each atlas has a thread for each core."""

REMEDY = "bake --vertex-colours, which needs no xatlas."

# How often charts are packed more tightly until they fit on a page.
TRIES = 20


@dataclass(frozen=True)
class Mesh:
    """A mesh to be cut.

    Attributes
    ----------
    points: positions, texels, (V, 3) float32. xatlas ignores triangles of an area below 1e-7.
    faces: indices of vertices, (M, 3) uint32.
    """

    points: np.ndarray
    faces: np.ndarray


@dataclass
class Flat:
    """The charts of a mesh.

    Attributes
    ----------
    vertices: the mesh's vertex that each vertex repeats, (W,).
    faces: indices of these vertices, (M, 3), in the order of the mesh's.
    uv: where the vertices lie on the page, texels, (W, 2) float32.
    """

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray


@dataclass(frozen=True)
class Packed:
    """The page.

    Attributes
    ----------
    size: its width and height, texels.
    scale: charts of the meshes' own size times this.
    charts: how many.
    """

    meshes: list[Flat]
    size: tuple[int, int]
    scale: float
    charts: int


def flatten(meshes: Sequence[Mesh], size: int | None) -> Packed:
    """Cut meshes into charts and pack them, scaled down until they fit on a page of ``size``.

    Without ``size``, the page is as large as the charts need at their own scale.
    The last try is returned, even where it does not fit.

    Raises
    ------
    UserError: xatlas is missing or failed.
    """
    if find_spec("xatlas") is None:
        raise UserError(
            "xatlas",
            "is not installed, so surfaces cannot be unwrapped",
            f"Run `pip install xatlas`, or {REMEDY}",
        )
    parts = [meshes[k : k + AT_ONCE] for k in range(0, len(meshes), AT_ONCE)]
    cut = [_ask(_cut_all, part) for part in parts]
    flat = [mesh for found, _ in cut for mesh in found]
    packed, extent, scale = _ask(_pack_all, flat, size)
    return Packed(packed, extent, scale, sum(charts for _, charts in cut))


def _ask(function: Callable[..., Any], *about: Any) -> Any:
    done = subprocess.run(
        [sys.executable, "-c", "from gpf.baking.xatlas_process import main; main()"],
        input=pickle.dumps((function, about)),
        capture_output=True,
        check=False,
    )
    if done.returncode:
        why = last_line(done.stderr.decode(errors="replace"))
        if done.returncode < 0:
            why = f"ended by signal {-done.returncode}"
        raise UserError("xatlas", f"failed: {why}", f"Try again, or {REMEDY}")
    return pickle.loads(done.stdout)


def _cut_all(meshes: Sequence[Mesh]) -> tuple[list[Flat], int]:
    """Meshes cut into charts, at their own scale, and how many charts."""
    # Each in an atlas of its own: with many meshes in one, `add_mesh` crashes now and then, because
    # its tasks are moved in memory while a thread reads one.
    atlases = [_new_atlas() for _ in meshes]
    flat = []
    for atlas, mesh in zip(atlases, meshes, strict=True):
        atlas.add_mesh(mesh.points, mesh.faces)
        flat += _generate(atlas, 1)
    return flat, sum(atlas.chart_count for atlas in atlases)


def _pack_all(meshes: list[Flat], size: int | None) -> tuple[list[Flat], tuple[int, int], float]:
    """Charts packed on a page, its width and height, and the scale."""
    scale = 1.0
    for _ in range(TRIES):
        packed, extent = _pack(_new_atlas(), meshes, scale)
        if size is None or max(extent) <= size:
            break
        scale *= min(size / max(extent), 0.98)
    return packed, extent, scale


def _pack(atlas: Any, meshes: Sequence[Flat], scale: float) -> tuple[list[Flat], tuple[int, int]]:
    for mesh in meshes:
        atlas.add_uv_mesh(mesh.uv, mesh.faces)
    packed = []
    for mesh, found in zip(meshes, _generate(atlas, scale), strict=True):
        uv = np.empty_like(mesh.uv)
        uv[found.vertices] = found.uv
        packed.append(Flat(mesh.vertices, mesh.faces, uv))
    return packed, (atlas.width, atlas.height)


def _generate(atlas: Any, scale: float) -> list[Flat]:
    """Cut and pack what was added to an atlas."""
    import xatlas

    cutting, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    cutting.max_cost = MAX_COST
    packing.padding, packing.texels_per_unit = PADDING, scale
    atlas.generate(cutting, packing)
    size = np.array([atlas.width, atlas.height], np.float32)
    meshes = [atlas.get_mesh(k) for k in range(atlas.mesh_count)]
    return [Flat(vertices, faces, uv * size) for vertices, faces, uv in meshes]


_atlases: list[Any] = []


def _new_atlas() -> Any:
    """An atlas that lives until the process ends."""
    import xatlas

    _atlases.append(xatlas.Atlas())
    return _atlases[-1]


def main() -> None:
    """What the process does: a request from its input, the answer to its output."""
    # xatlas prints, too.
    answers = os.dup(1)
    os.dup2(2, 1)
    try:
        function, about = pickle.load(sys.stdin.buffer)
        with os.fdopen(answers, "wb") as stream:
            stream.write(pickle.dumps(function(*about)))
        os._exit(0)
    except Exception:
        traceback.print_exc()
        os._exit(1)
