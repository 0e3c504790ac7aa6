"""Photon maps of small scenes, and the power in them."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from gpf.core.structs import Photons, to_numpy
from gpf.photons.tracing import PathSettings, record_photons
from tests.furnace import Scene, diffuse, point_light, room

L = np.array([1.0, 2.0, 3.0])
BLACK_ROOM = {"room": room(diffuse(0))}


def closed_room(*albedo: float) -> Scene:
    return {"room": room(diffuse(*albedo)), "light": point_light((0.3, -0.2, 0.1), *L)}


def record(scene: Scene, paths: int = 100_000, seed: int = 1, **options: object) -> Photons:
    loaded = mi.load_dict({"type": "scene"} | scene)
    capacity = options.pop("capacity", None)
    settings = PathSettings(paths, **options)  # type: ignore[arg-type]
    return record_photons(loaded, settings, seed, capacity)  # type: ignore[arg-type]


def total(photons: Photons) -> np.ndarray:
    return to_numpy(photons.power).sum(0, dtype=np.float64)


def total_by_depth(photons: Photons, depths: int) -> np.ndarray:
    """(depths, 3)."""
    power, depth = to_numpy(photons.power).astype(np.float64), photons.depth.numpy()
    return np.stack([power[depth == d].sum(0) for d in range(depths)])
