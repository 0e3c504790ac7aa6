"""The flicker of an animation's frames, and the flicker that noise in references would cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.core.images import check_finite, read_exr
from gpf.scene.views import View
from metrics.flicker import (
    FramePoints,
    change_of_noise,
    link_frames,
    measure_flicker,
    smooth_pixels,
)
from stages.animation.frame_points import see_points
from stages.common.workspace import Workspace

WAYS = ("directly", "refracted")
"""Kinds of visible surfaces, named as in :class:`SeenPoints`; flicker is measured for each."""


def compare_frames(
    work: Workspace, frames: Mapping[str, Sequence[Path]], views: Sequence[View]
) -> dict[str, Any]:
    """Flicker of each method on surfaces that are visible directly, and through water or glass.

    Parameters
    ----------
    frames: method -> the image files of the views.
    """
    scene, closed = work.load_scene(), bool(work.views.path and work.views.path.closed)
    seen = [see_ways(scene, view, work) for view in views]
    links = {}
    for way in WAYS:
        points = [ways[way] for ways in seen]
        steps = list(zip(points, [*points[1:], points[0]], strict=True))
        found = [link_frames(a, b) for a, b in (steps if closed else steps[:-1])]
        if any(len(link.later) for link in found):
            links[way] = found
    methods: dict[str, dict[str, Any]] = {}
    for method, files in frames.items():
        images = [read_exr(file)[0]["radiance"] for file in files]
        for file, image in zip(files, images, strict=True):
            check_finite(image, str(file))
        methods[method] = {}
        for way, found in links.items():
            flicker = measure_flicker(images, found, work.views.exposure)
            methods[method][way] = {**asdict(flicker), "noise": flicker.noise}
    return {
        "unit": "levels of 255",
        "frames": len(views),
        "methods": methods,
        "noise_of_references": noise_of_references(work, scene),
    }


def see_ways(scene: mi.Scene, view: View, work: Workspace) -> dict[str, FramePoints]:
    """The points that a view's pixels see, for each of :data:`WAYS`."""
    seen = see_points(scene, view, work.film_size)
    return {way: FramePoints(seen.points, getattr(seen, way)) for way in WAYS}


def noise_of_references(work: Workspace, scene: mi.Scene) -> dict[str, dict[str, float]]:
    """The change between frames that references of the path would show due to their noise alone.

    It is computed from the novel views, in the kinds of pixels in which methods are measured;
    ``share`` is the share of these pixels.
    """
    found: dict[str, list[np.ndarray]] = {way: [] for way in WAYS}
    noise: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {way: [] for way in WAYS}
    for view in work.views.novel:
        path = work.reference(view.name)
        layers = read_exr(path)[0] if path.exists() else {}
        if "standard_error" in layers:
            for way, points in see_ways(scene, view, work).items():
                kept = smooth_pixels(points)
                found[way].append(kept)
                noise[way].append((layers["radiance"][kept], layers["standard_error"][kept]))
    result = {}
    for way in WAYS:
        if np.any(found[way]):
            radiance, error = (np.concatenate(part) for part in zip(*noise[way], strict=True))
            change = change_of_noise(radiance, error, work.views.exposure)
            result[way] = {"change": change, "share": float(np.mean(found[way]))}
    return result
