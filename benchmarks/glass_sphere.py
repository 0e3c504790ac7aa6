"""The Cornell box with a glass sphere: times of SPPM passes, of the field, and of Mitsuba."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from benchmarks.timing import Timings, time_in_turn
from gpf.core.structs import to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.initialization import TYPICAL_SCALE, propose_search_radius
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds
from stages.config.training import InitialFieldSettings
from stages.training.photon_gaussians import initialize_gaussians

PHOTONS = 100_000


def cornell_box(width: int, height: int) -> dict[str, Any]:
    """Mitsuba's Cornell box with a film of this size."""
    scene = mi.cornell_box()
    scene["sensor"]["film"].update(width=width, height=height, rfilter={"type": "box"})
    return dict(scene)


def load_scene(width: int, height: int) -> mi.Scene:
    """The Cornell box with a glass sphere in place of the small box."""
    scene = cornell_box(width, height)
    del scene["small-box"]
    scene["sphere"] = {
        "type": "sphere",
        "center": [0.335, -0.64, 0.38],
        "radius": 0.35,
        "bsdf": {"type": "dielectric", "int_ior": 1.5},
    }
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

    work = {
        "path": lambda n: render(path, scene, n),
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
