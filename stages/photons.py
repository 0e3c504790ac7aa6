"""Stage `photons`: trace the photons that become Gaussians."""

from __future__ import annotations

import drjit as dr

from gpf.artifacts import write_tensors
from gpf.errors import UserError
from gpf.photon_map import collect_photons
from gpf.structs import to_numpy
from stages.costs import CostMeter
from stages.lookout import Lookout
from stages.most_gaussians import most_gaussians
from stages.workspace import Workspace


def trace(scene_name: str) -> None:
    """Trace photons and keep those that met diffuse surfaces in the outlook."""
    work = Workspace.open(scene_name)
    section = work.params.photons
    scene = work.load_scene()
    costs = CostMeter()
    with costs.measure("photons"):
        lookout = Lookout.open(work, scene)
        paths = section.paths
        if paths == "auto":
            paths = lookout.paths_for_gaussians(most_gaussians(work.params.field.gaussians))
        photons = collect_photons(
            scene, lookout.outlook, paths, section.seed, section.rr_depth, lookout.source
        )
    if dr.width(photons.p) == 0:
        raise UserError(
            f"scene {scene_name!r}",
            "no photon reached a diffuse surface that cameras can see",
            "Check where the emitters point, or set outlook.use to false in params.yaml.",
        )
    tensors = {
        "position": to_numpy(photons.p),
        "normal": to_numpy(photons.n),
        "power": to_numpy(photons.power),
        "depth": to_numpy(photons.depth),
    }
    write_tensors(work.photons, "photons", tensors, {"paths": paths})
    costs.facts |= {"paths": paths, "stored": dr.width(photons.p), **lookout.facts()}
    costs.write(work.cost("photons"))
