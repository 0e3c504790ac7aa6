"""Facts about an imported scene: emitters, materials, sizes and proposed radii."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.film import sample_film
from gpf.core.errors import UserError
from gpf.core.structs import Photons, VisiblePoints, to_numpy
from gpf.guiding.pilot import trace_pilot
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds
from gpf.scene.media import Media
from gpf.scene.sensors import make_sensor
from gpf.scene.solids import OVERLAP, overlapping_solids
from gpf.scene.untraceable import telling_untraceable
from gpf.scene.views import SceneViews, View
from gpf.sppm.passes import propose_radius
from stages.importing.materials import PLUGINS, Material, list_materials
from stages.training.photon_gaussians import propose_search_radius

PHOTONS = 100_000
"""Photon paths per pass, and Gaussians, for which radii are proposed."""

NOTES = {
    "circular": "in RGB, a neutral filter that halves the light it transmits",
    "directionalarea": "photons see its light; Mitsuba's path tracer does not",
    "hair": "traced through: hair itself stores no photons",
    "measured": "traced through as a glossy material, including its diffuse part",
    "polarizer": "in RGB, a neutral filter that halves the light it transmits",
    "pplastic": "light is assumed to be unpolarised",
    "retarder": "no effect in RGB: all light passes",
}
"""Plugin -> how photon mapping treats it, where that may be unexpected."""


@dataclass(frozen=True)
class SceneReport:
    """Facts found about a scene.

    Attributes
    ----------
    emitters: plugin -> number of emitters.
    materials: the materials in use.
    size, diagonal: size and diagonal of the bounding box, world units.
    camera_distance: median distance from the first camera to its visible points, world units.
    landing: share of the emitted photon paths that store a photon.
    photons: number of photon paths, and of Gaussians, for which the radii are proposed.
    initial_radius: kernel radius for ``photons`` photon paths per pass, world units.
    search_radius: search radius for ``photons`` Gaussians, world units.
    warnings: what is ignored or looks wrong, in words.
    """

    emitters: dict[str, int]
    materials: tuple[Material, ...]
    size: tuple[float, float, float]
    diagonal: float
    camera_distance: float
    landing: float
    photons: int
    initial_radius: float
    search_radius: float
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class ImportReport:
    """What was imported.

    Attributes
    ----------
    name, folder: name and folder of the new scene.
    origin: name of the folder, file or archive that the scene came from.
    files, size: number of copied files, and their total size in bytes.
    scene: facts found about the scene.
    views: the views that were placed.
    warnings: what was not imported or is shown differently, in words.
    """

    name: str
    folder: Path
    origin: str
    files: int
    size: int
    scene: SceneReport
    views: SceneViews
    warnings: tuple[str, ...]


def examine_scene(
    scene: mi.Scene, view: View, aspect: float, where: str, photons: int = PHOTONS
) -> SceneReport:
    """Trace photons and the camera rays of one view, and report what is found.

    Parameters
    ----------
    where: the scene's name in messages.
    photons: number of photon paths, and of Gaussians, for which the radii are proposed.

    Raises
    ------
    UserError: light or camera rays cannot be traced, no photon reaches a diffuse surface, or the
        view sees no diffuse surface.
    """
    points, landing, stored = _trace(scene, view, aspect, where, photons)
    origin = np.array(view.origin)
    seen = to_numpy(points.p)[np.asarray(points.valid.numpy())]
    if landing == 0:
        raise UserError(
            where,
            f"none of {photons:,} photon paths reached a diffuse surface",
            "Check where the emitters point and what is in their way.",
        )
    if len(seen) == 0:
        raise UserError(
            where, "its sensor sees no diffuse surface", "Point the sensor at a diffuse surface."
        )
    bounds = scene_bounds(scene)
    size = np.array([bounds[1][i] - bounds[0][i] for i in range(3)], dtype=float)
    emitters = Counter(PLUGINS.get(e.class_name(), e.class_name()) for e in scene.emitters())
    materials = list_materials(scene)
    return SceneReport(
        emitters=dict(sorted(emitters.items())),
        materials=materials,
        size=(float(size[0]), float(size[1]), float(size[2])),
        diagonal=float(np.linalg.norm(size)),
        camera_distance=float(np.median(np.linalg.norm(seen - origin, axis=1))),
        landing=landing,
        photons=photons,
        initial_radius=propose_radius(scene, points, PathSettings(photons)),
        search_radius=propose_search_radius(stored, photons, seen, bounds),
        warnings=(*_notes(scene, emitters, materials), *_clipping(float(np.linalg.norm(size)))),
    )


def _trace(
    scene: mi.Scene, view: View, aspect: float, where: str, photons: int
) -> tuple[VisiblePoints, float, Photons]:
    """Visible points of the view, share of photon paths that store a photon, and the photons."""
    height = 64
    width = max(1, round(height * aspect))
    with telling_untraceable(where):
        stored = record_photons(scene, PathSettings(photons), seed=1)
        landing = float(
            (trace_pilot(scene, None, PathSettings(photons), seed=0).photons > 0).mean()
        )
        points = sample_film(scene, make_sensor(view, width, height), seed=0).points
        dr.eval(points)
    return points, landing, stored


def _notes(scene: mi.Scene, emitters: Counter[str], materials: Sequence[Material]) -> list[str]:
    """Remarks on media, plugins and materials in use."""
    plugins = dict.fromkeys([*emitters, *(p for m in materials for p in m.kind.split())])
    notes = [f"{plugin}: {NOTES[plugin]}" for plugin in plugins if plugin in NOTES]
    if media := describe_media(scene):
        notes.insert(0, media)
    notes += [OVERLAP % pair for pair in overlapping_solids(scene)]
    for material in materials:
        if material.use == "unsupported":
            notes.append(
                f"{material.name} ({material.kind}): paths end there and nothing is stored"
            )
    return notes


def describe_media(scene: mi.Scene) -> str:
    """The scene's participating media in words; empty if it has none."""
    kinds = Counter("homogeneous" if m.is_homogeneous() else "grid" for m in Media(scene).every)
    if not kinds:
        return ""
    parts = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    noun = "medium" if kinds.total() == 1 else "media"
    return f"participating {noun}: {parts}"


def _clipping(diagonal: float) -> list[str]:
    if 0.1 < diagonal < 1e4:
        return []
    return [
        f"its diagonal is {diagonal:.3g} units, but cameras see only distances from 0.001 to "
        "100,000 units: scale the scene so that lengths are of the order of 1"
    ]
