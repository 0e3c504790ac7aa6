"""Stage `photons`: trace the photons that become Gaussians."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.files import (
    read_tensors,
    require_finite,
    require_scene,
    require_shapes,
    write_tensors,
)
from gpf.core.structs import Photons, from_numpy, to_numpy
from stages.common.costs import CostMeter
from stages.common.workspace import Workspace
from stages.config.training import most_gaussians


def run(scene_name: str) -> None:
    """Trace photons; save those that land on diffuse surfaces in the visible region."""
    work = Workspace.open(scene_name)
    section = work.params.photons
    scene = work.load_scene()
    costs = CostMeter()
    with costs.measure("photons"):
        plan = work.emission_plan(scene)
        paths = section.paths
        if paths == "auto":
            paths = plan.paths_for_gaussians(most_gaussians(work.params.field.gaussians))
        photons = plan.collect(scene, paths, section.seed, section.rr_depth)
    if dr.width(photons.p) == 0:
        raise UserError(
            f"scene {scene_name!r}",
            "no photon reached a diffuse surface that cameras can see",
            "Check where the emitters point, or set visible_region.use to false in params.yaml.",
        )
    tensors = {
        "position": to_numpy(photons.p),
        "normal": to_numpy(photons.n),
        "power": to_numpy(photons.power),
        "depth": to_numpy(photons.depth),
    }
    write_tensors(work.photons, "photons", tensors, {"paths": paths, "scene": scene_name})
    costs.facts |= {"paths": paths, "stored": dr.width(photons.p), **plan.facts()}
    costs.write(work.cost("photons"))


def load_photons(work: Workspace) -> Photons:
    """The photons that this stage saved."""
    tensors, metadata = read_tensors(work.photons, "photons")
    require_scene(work.photons, metadata, work.scene)
    vectors = {name: (("N", 3), "f4") for name in ("position", "normal", "power")}
    require_shapes(work.photons, tensors, vectors | {"depth": (("N",), "u4")})
    require_finite(work.photons, tensors)

    def columns(name: str) -> np.ndarray:
        return np.ascontiguousarray(tensors[name].T)

    return Photons(
        p=mi.Point3f(columns("position")),
        n=mi.Normal3f(columns("normal")),
        power=mi.Color3f(columns("power")),
        depth=from_numpy(mi.UInt32, tensors["depth"]),
    )
