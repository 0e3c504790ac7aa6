"""Scenes with media."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from tests.furnace import Scene, camera, diffuse, lamp, rectangle

NULL = {"type": "null"}


def medium(extinction: Any, albedo: Any = 0.9, g: float = 0.0) -> Scene:
    """A homogeneous medium; extinctions, 1/m, of one or three channels."""
    scale = float(np.max(extinction))  # Mitsuba's colours end at 1
    return {
        "type": "homogeneous",
        "albedo": _colour(albedo),
        "sigma_t": _colour(np.asarray(extinction) / scale),
        "scale": scale,
        "phase": {"type": "hg", "g": g} if g else {"type": "isotropic"},
    }


def _colour(value: Any) -> Scene:
    return {"type": "rgb", "value": np.broadcast_to(value, 3).astype(float).tolist()}


def cloud(density: float, albedo: float = 0.9, side: int = 16, half: float = 1.0) -> Scene:
    """A medium on a grid, densest in the middle of the cube of fog_box."""
    x = np.linspace(-1, 1, side)
    square = x**2 + x[:, None] ** 2 + x[:, None, None] ** 2
    grid = mi.VolumeGrid(np.exp(-2 * square)[..., None].astype(np.float32))
    place = mi.ScalarTransform4f().translate([-half] * 3).scale([2 * half] * 3)
    return {
        "type": "heterogeneous",
        "albedo": {"type": "constvolume", "value": {"type": "rgb", "value": [albedo] * 3}},
        "sigma_t": {"type": "gridvolume", "grid": grid, "to_world": place},
        "scale": density,
    }


def fog_box(inside: Scene, size: tuple[int, int] = (24, 24), **objects: Scene) -> Scene:
    """A cube of 2 around the origin with a medium, above a floor and below a lamp, and a ball in
    it. The camera is outside."""
    return {
        "type": "scene",
        "sensor": camera((0, -5, 0.6), (0, 0, 0), 34, size),
        "box": {"type": "cube", "bsdf": NULL, "interior": inside},
        "floor": rectangle((0, 0, -1.2), (0, 0, 0), 6, 6, diffuse(0.6, 0.5, 0.4)),
        "lamp": lamp((0, 0, 2.5), (0, 0, 0), 1, 20, 15, 10),
        "ball": {"type": "sphere", "radius": 0.4, "bsdf": diffuse(0.5)},
    } | objects
