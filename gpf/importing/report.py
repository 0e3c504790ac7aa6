"""What photon mapping makes of a scene: emitters, materials, sizes, radii that suit it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.film import sample_film
from gpf.core.errors import UserError
from gpf.core.structs import Photons, VisiblePoints, to_numpy
from gpf.field.initialization import propose_search_radius
from gpf.guiding.pilot import trace_pilot
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds
from gpf.scene.inventory import scene_info, scene_materials
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.sppm.passes import propose_radius

Use = Literal["queried", "traced through", "both", "unsupported"]

PLUGINS = {
    "AreaLight": "area",
    "BlendBSDF": "blendbsdf",
    "BumpMap": "bumpmap",
    "CircularPolarizer": "circular",
    "ConstantBackgroundEmitter": "constant",
    "DirectionalArea": "directionalarea",
    "DirectionalEmitter": "directional",
    "EnvironmentMapEmitter": "envmap",
    "Hair": "hair",
    "LinearPolarizer": "polarizer",
    "LinearRetarder": "retarder",
    "MaskBSDF": "mask",
    "Measured": "measured",
    "MeasuredPolarized": "measured_polarized",
    "NormalMap": "normalmap",
    "Null": "null",
    "PointLight": "point",
    "PolarizedPlastic": "pplastic",
    "Projector": "projector",
    "RoughConductor": "roughconductor",
    "RoughDielectric": "roughdielectric",
    "RoughPlastic": "roughplastic",
    "SmoothConductor": "conductor",
    "SmoothDielectric": "dielectric",
    "SmoothDiffuse": "diffuse",
    "SmoothPlastic": "plastic",
    "SpotLight": "spot",
    "SunskyEmitter": "sunsky",
    "ThinDielectric": "thindielectric",
    "TwoSidedBRDF": "twosided",
}
"""Mitsuba's classes and what scene files call them."""

NOTES = {
    "circular": "in RGB a neutral filter: half of what it transmits passes",
    "directionalarea": "photons see its light; Mitsuba's path tracer does not",
    "hair": "traced through: hair itself stores no photons",
    "measured": "traced through as a glossy material, its diffuse part too",
    "polarizer": "in RGB a neutral filter: half of what it transmits passes",
    "pplastic": "light is taken to be unpolarised",
    "retarder": "in RGB without effect: all light passes",
}
"""What differs from what one might expect, by plugin."""


@dataclass(frozen=True)
class Material:
    """A material in use.

    Attributes
    ----------
    name: its id, or one from its shape. kind: its plugins, outermost first.
    use: photons are stored and camera rays end there (queried), paths go on (traced through), or
        one or the other, at random (both).
    """

    name: str
    kind: str
    use: Use


@dataclass(frozen=True)
class SceneReport:
    """What was found out about a scene.

    Attributes
    ----------
    emitters: plugin -> number.
    size, diagonal: of the bounding box, world units.
    camera_distance: median distance from the first camera to what it sees, world units.
    landing: share of the emitted photon paths that leave a photon.
    initial_radius: of the kernel, for ``photons`` photon paths per pass.
    search_radius: for ``photons`` Gaussians.
    warnings: what is left out or looks wrong, in words.
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


def examine_scene(
    scene: mi.Scene, view: View, aspect: float, where: str, photons: int = 100_000
) -> SceneReport:
    """Find out about a scene, with photons and with camera rays of one of its views.

    ``photons`` is the number of photon paths and Gaussians that the radii are proposed for.

    Raises
    ------
    UserError: light or camera rays cannot be traced, no photon reaches a diffuse surface, or the
        view sees none. ``where`` is what messages call the scene.
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
            where, "its sensor sees no diffuse surface", "Point the sensor at one that is diffuse."
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


def list_materials(scene: mi.Scene) -> tuple[Material, ...]:
    """The materials in use, and what photon mapping does with each."""
    uses: dict[tuple[bool, bool], Use] = {
        (True, False): "queried",
        (False, True): "traced through",
        (True, True): "both",
        (False, False): "unsupported",
    }
    info = scene_info(scene)["bsdfs"]
    return tuple(
        Material(name, kind_of(bsdf), uses[info[name]["queried"], info[name]["traced"]])
        for name, bsdf in scene_materials(scene).items()
    )


def kind_of(bsdf: mi.BSDF) -> str:
    """The plugins of a material, outermost first: ``twosided diffuse``."""
    nested = [o for o in mi.traverse(bsdf).hierarchy if isinstance(o, mi.BSDF)]
    return " ".join(dict.fromkeys(PLUGINS.get(o.class_name(), o.class_name()) for o in nested))


def _trace(
    scene: mi.Scene, view: View, aspect: float, where: str, photons: int
) -> tuple[VisiblePoints, float, Photons]:
    """Visible points of the view, share of photon paths that land, and photons."""
    height = 64
    width = max(1, round(height * aspect))
    try:
        stored = record_photons(scene, PathSettings(photons), seed=1)
        landing = float(
            (trace_pilot(scene, None, PathSettings(photons), seed=0).photons > 0).mean()
        )
        points = sample_film(scene, make_sensor(view, width, height), seed=0).points
        dr.eval(points)
    except RuntimeError as error:
        if not isinstance(_origin_of(error), RuntimeError):
            raise
        what = str(_origin_of(error)).strip().splitlines()[0]
        todo = "Replace the material or emitter that Mitsuba names."
        if "eval_1_grad" in what:
            todo = "A bumpmap needs a bitmap texture; this one's cannot tell its slope."
        raise UserError(where, f"light cannot be traced in it: {what}", todo) from error
    return points, landing, stored


def _origin_of(error: BaseException) -> BaseException:
    """What began it: Dr.Jit wraps errors that occur inside its loops."""
    while inner := error.__cause__ or error.__context__:
        error = inner
    return error


def _notes(scene: mi.Scene, emitters: Counter[str], materials: Sequence[Material]) -> list[str]:
    """Remarks on the plugins in use, each once."""
    plugins = dict.fromkeys([*emitters, *(p for m in materials for p in m.kind.split())])
    notes = [f"{plugin}: {NOTES[plugin]}" for plugin in plugins if plugin in NOTES]
    media = [o for o in mi.traverse(scene).hierarchy if isinstance(o, mi.Medium)]
    if media:
        what = "a participating medium" if len(media) == 1 else f"{len(media)} participating media"
        notes.insert(0, f"{what}: ignored, light passes as if the space were empty")
    for material in materials:
        if material.use == "unsupported":
            notes.append(f"{material.name} ({material.kind}): paths end there, nothing is stored")
    return notes


def _clipping(diagonal: float) -> list[str]:
    if 0.1 < diagonal < 1e4:
        return []
    return [
        f"its diagonal is {diagonal:.3g} units, but views see from 0.001 to 100,000 units: "
        "scale it so that lengths are of the order of 1"
    ]
