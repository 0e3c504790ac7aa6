"""What a field starts from and learns from, as params.yaml has it: photons, targets, Gaussians."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.artifacts import read_tensors
from gpf.errors import UserError
from gpf.field import FieldSettings, GaussianPhotonField
from gpf.gap_filling import find_gaps
from gpf.initialization import (
    InitializationSettings,
    initialize_gaussians,
    propose_search_radius,
)
from gpf.structs import Photons, SurfacePoints, take
from gpf.supervision import Targets
from stages.progress import say
from stages.workspace import Workspace


def load_photons(work: Workspace) -> Photons:
    """The photons that the stage `photons` kept."""
    tensors, _ = read_tensors(work.photons, "photons", "photons")

    def columns(name: str) -> np.ndarray:
        return np.ascontiguousarray(tensors[name].T)

    return Photons(
        p=mi.Point3f(columns("position")),
        n=mi.Normal3f(columns("normal")),
        power=mi.Color3f(columns("power")),
        depth=mi.UInt32(tensors["depth"]),
    )


def photons_for_field(work: Workspace, photons: Photons) -> Photons:
    """Those of the light that the field is to have."""
    section = work.params.field
    if section.direct == "field":
        return photons
    indirect = dr.compress(photons.depth > 0)
    count = dr.width(indirect)
    if count == 0:
        raise UserError(
            f"scene {work.scene!r}",
            "its photons are direct light alone, which field.direct: emitters leaves to emitters",
            "Set field.direct to field.",
        )
    if section.gaussians != "auto" and count < section.gaussians:
        say(
            f"{work.scene}: {count} of the photons are not direct light; the field has as many "
            f"Gaussians, not {section.gaussians}. More photons.paths bring more"
        )
    return take(photons, indirect)


def supervise(work: Workspace, targets: Targets) -> SurfacePoints:
    """The points that params.yaml has the field learn from, out of all targets."""
    section, fields = work.params.train, work.params.field
    return targets.supervised_points(section.points, fields.stores, section.loss, fields.direct)


def initial_field(
    work: Workspace, count: int, photons: Photons, targets: Targets, bounds: tuple[Any, Any]
) -> GaussianPhotonField:
    """The field before training, with so many Gaussians."""
    section = work.params.field
    radius = section.search_radius
    if radius == "auto":
        radius = propose_search_radius(photons, count, targets.position, bounds)
    scale = 0.6 * radius if section.initial_scale == "auto" else section.initial_scale
    initial = InitializationSettings(
        gaussians=count,
        source=section.initialization,
        # That of the targets is not known here: the trainer sees to it.
        colour="density" if section.initial_colour == "density" else "flux",
        scale=scale,
        density_radius=radius,
    )
    settings = FieldSettings(
        search_radius=radius,
        k=section.k,
        neighbours=section.neighbours,
        blend=section.blend,
        stores=section.stores,
        direct=section.direct,
        normal_test=section.normal_test,
    )
    seed = work.params.train.seed
    gaussians = initialize_gaussians(photons, initial, bounds, seed)
    if section.fill_gaps and section.initialization == "photons":
        field = GaussianPhotonField(gaussians, settings, bounds)
        gaps = find_gaps(field, targets.position, targets.normal, seed)
        gaussians = initialize_gaussians(photons, initial, bounds, seed, gaps)
    if section.stores == "radiance":
        # Photons know nothing of what reflects their light; views do, on average.
        mean = targets.select("views").reflectance.mean(axis=0) / np.pi
        gaussians.irradiance *= mi.Color3f(*(float(c) for c in mean))
    return GaussianPhotonField(gaussians, settings, bounds)
