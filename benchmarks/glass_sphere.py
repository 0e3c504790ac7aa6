"""The Cornell box with a glass sphere: times of SPPM passes, of the field, and of Mitsuba."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from benchmarks.timing import Timings, time_in_turn
from gpf.core.structs import from_numpy, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.field.initialization import TYPICAL_SCALE
from gpf.field.settings import FieldSettings
from gpf.field.volume import VolumeField
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds
from gpf.training.volume_light import DISTANCE
from stages.config.training import InitialFieldSettings
from stages.training.photon_gaussians import initialize_gaussians, propose_search_radius

PHOTONS = 100_000


def cornell_box(width: int, height: int) -> dict[str, Any]:
    """Mitsuba's Cornell box with a film of this size."""
    scene = mi.cornell_box()
    scene["sensor"]["film"].update(width=width, height=height, rfilter={"type": "box"})
    return dict(scene)


FOG = {
    "type": "homogeneous",
    "id": "fog",
    "sigma_t": {"type": "rgb", "value": [0.3, 0.3, 0.3]},
    "albedo": {"type": "rgb", "value": [0.9, 0.9, 0.9]},
    "phase": {"type": "hg", "g": 0.3},
}


def load_scene(width: int, height: int, fog: bool = False) -> mi.Scene:
    """The Cornell box with a glass sphere in place of the small box; with fog on request."""
    scene = cornell_box(width, height)
    del scene["small-box"]
    scene["sphere"] = {
        "type": "sphere",
        "center": [0.335, -0.64, 0.38],
        "radius": 0.35,
        "bsdf": {"type": "dielectric", "int_ior": 1.5},
    }
    if fog:
        there = {"type": "ref", "id": "fog"}
        scene["sensor"]["medium"] = scene["sphere"]["exterior"] = there
        scene = {"type": "scene", "fog": FOG} | scene
    return mi.load_dict(scene)


def measure(size: int, radius: float, methods: Sequence[str]) -> Timings:
    """Time some of one SPPM pass, one sample per pixel from a field, `path` and `ptracer`, in
    turn."""
    scene = load_scene(size, size)
    # ptracer traces as many paths as there are pixels: 400 x 250 = 100,000.
    particles = load_scene(400, 250)
    path = mi.load_dict({"type": "path", "max_depth": 2})
    ptracer = mi.load_dict({"type": "ptracer"})
    field, recorded = (mi.load_dict({"type": "gpf", "record": r}) for r in (False, True))
    field.field = recorded.field = untrained_field(scene, radius=radius)
    # One pass per render: every pass is a first pass and has the full radius.
    sppm = mi.load_dict(
        {"type": "sppm", "photons_per_pass": PHOTONS, "initial_radius": radius, "max_depth": -1}
    )

    def render(integrator: Any, of: Any, seed: int) -> None:
        dr.eval(mi.render(of, integrator=integrator, spp=1, seed=seed))

    foggy = load_scene(size, size, fog=True)
    volpath = mi.load_dict({"type": "volpath", "max_depth": -1})
    work = {
        "path": lambda n: render(path, scene, n),
        "volpath": lambda n: render(volpath, foggy, n),
        "sppm in fog": lambda n: render(sppm, foggy, n),
        "ptracer": lambda n: render(ptracer, particles, n),
        "sppm": lambda n: render(sppm, scene, n),
        "gpf": lambda n: render(field, scene, n),
        "gpf, recorded": lambda n: render(recorded, scene, n),
    }
    return time_in_turn({name: work[name] for name in methods})


def untrained_field(
    scene: mi.Scene, gaussians: int = PHOTONS, radius: float | None = None
) -> GaussianPhotonField:
    """A field with Gaussians where photons land; training hardly moves them. ``radius``: of the
    search, by default one that suits their number."""
    bounds = scene_bounds(scene)
    photons = record_photons(scene, PathSettings(gaussians), seed=1)
    if radius is None:
        radius = propose_search_radius(photons, gaussians, to_numpy(photons.p)[:10_000], bounds)
    settings = InitialFieldSettings(
        gaussians=gaussians,
        initial_colour="density",
        initial_scale=TYPICAL_SCALE * radius,
        search_radius=radius,
    )
    placed = initialize_gaussians(photons, settings, bounds, seed=1)
    return GaussianPhotonField(placed, settings.query(radius), bounds)


def untrained_volume(scene: mi.Scene, gaussians: int) -> VolumeField:
    """Gaussians everywhere in fog, as far apart as those of a fit."""
    bounds = scene_bounds(scene)
    lower, edges = np.array(bounds[0]), np.array(bounds[1] - bounds[0])
    places = lower + edges * np.random.default_rng(1).random((gaussians, 3))
    p, radius = from_numpy(mi.Point3f, places), (edges.prod() / gaussians) ** (1 / 3) / DISTANCE
    colour = np.ones((gaussians, 3), np.float32)
    placed = Gaussians(
        means=p,
        log_scales=dr.full(mi.Vector3f, float(np.log(TYPICAL_SCALE * radius)), gaussians),
        quats=dr.full(mi.Quaternion4f, 0, gaussians) + mi.Quaternion4f(0, 0, 0, 1),
        irradiance=from_numpy(mi.Color3f, colour),
        normals=dr.zeros(mi.Normal3f, gaussians),
    )
    settings = FieldSettings(search_radius=float(radius), normal_test=False)
    moments = np.ones((gaussians, 2, 3, 4), np.float32)
    return VolumeField(GaussianPhotonField(placed, settings, bounds), moments)
