"""Stage `photons`: trace the photons that become Gaussians."""

from __future__ import annotations

import drjit as dr

from gpf.artifacts import write_tensors
from gpf.errors import UserError
from gpf.photon_tracing import record_photons
from gpf.structs import to_numpy
from stages.costs import CostMeter
from stages.workspace import Workspace


def trace(scene_name: str) -> None:
    """Trace one set of photons and keep all that met diffuse surfaces."""
    work = Workspace.open(scene_name)
    section = work.params.photons
    scene = work.load_scene()
    costs = CostMeter()
    with costs.measure("photons"):
        photons = record_photons(
            scene, paths=section.paths, seed=section.seed, rr_depth=section.rr_depth
        )
    if dr.width(photons.p) == 0:
        raise UserError(
            f"scene {scene_name!r}",
            "no photon reached a diffuse surface",
            "Check where the emitters point.",
        )
    tensors = {
        "position": to_numpy(photons.p),
        "normal": to_numpy(photons.n),
        "power": to_numpy(photons.power),
        "depth": to_numpy(photons.depth),
    }
    write_tensors(work.photons, "photons", tensors, {"paths": section.paths})
    costs.facts["stored"] = dr.width(photons.p)
    costs.write(work.cost("photons"))
