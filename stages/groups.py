"""The groups of a scene's references: what each renders, and with what seeds.

Training views (their fixed visible points and samples of the scene's surfaces become targets),
novel views (the judges), novel views once more (the ceiling: how well does SPPM agree with itself),
and more training views for systems that learn from pictures. Within a group the views share their
photons; between groups nothing is shared, or noise that the field learned would count as quality.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from gpf.bounds import scene_bounds
from gpf.emission import Source
from gpf.film import sample_film
from gpf.pass_parts import PassParts
from gpf.photon_map import collect_photons
from gpf.photon_tracing import record_photons
from gpf.progressive import PassSettings, propose_radius
from gpf.reference import ReferenceRenderer, fixed_points
from gpf.seeds import pass_seed
from gpf.structs import Photons, VisiblePoints
from gpf.surface_samples import Places, sample_surface_points
from gpf.views import View
from stages.costs import CostMeter
from stages.imaged_views import images_of
from stages.lookout import Lookout
from stages.passes import SURFACES, LongSum
from stages.reference_records import group_record
from stages.workspace import Workspace

GROUPS = ("train", "novel", "ceiling", "more")

# With `photons_per_pass: auto`, a pass is as good as so many paths that bring equal power.
EQUAL_PATHS = 50_000

# Paths whose photons tell what is lit beyond the outlook, at most. They are weighed by how many lie
# within a pass's kernel: more than a pass has would cost as their square.
ARRIVAL_PATHS = 100_000


@dataclass(frozen=True)
class Job:
    """What all groups of one run have in common."""

    work: Workspace
    scene: Any
    lookout: Lookout
    settings: PassSettings
    costs: CostMeter

    @classmethod
    def open(cls, work: Workspace) -> Job:
        """Load the scene, and measure what is automatic."""
        scene = work.load_scene()
        costs = CostMeter.load(work.cost("reference"))
        costs.parts.pop("radius", None)
        with costs.measure("radius"):
            lookout = Lookout.open(work, scene)
            settings = pass_settings(work, scene, lookout)
        return cls(work, scene, lookout, settings, costs)

    def collect(self, paths: int, seed: int) -> Photons:
        """Photons in the outlook, of so many paths."""
        outlook, source = self.lookout.outlook, self.lookout.source
        return collect_photons(self.scene, outlook, paths, seed, self.settings.rr_depth, source)

    def arrivals(self, seed: int) -> Photons:
        """Photons of some paths, wherever they land."""
        return record_photons(
            self.scene,
            paths=min(ARRIVAL_PATHS, self.settings.photons_per_pass),
            seed=pass_seed(seed, 0, stream=13),
            rr_depth=self.settings.rr_depth,
            source=self.lookout.source,
        )


@dataclass(frozen=True)
class GroupRequest:
    """What is to be rendered of a group: the views with these names, and surface samples or not."""

    group: str
    views: tuple[str, ...]
    surfaces: bool


def open_group(job: Job, request: GroupRequest) -> LongSum:
    """The passes of a group: what renders them, and the parts that are done."""
    work, group = job.work, request.group
    record, seed = record_of(job, group), _group_seed(job, group)
    views = [view for view in views_of(work, group) if view.name in request.views]
    points = {}
    if group == "train":
        surfaces = work.params.reference.surface_points if request.surfaces else 0
        points = target_points(job, views, record["share"], surfaces, seed)
    sensors = {view.name: work.sensor(view) for view in views if view.name in record["imaged"]}
    source = job.lookout.source
    renderer = ReferenceRenderer(job.scene, sensors, points, job.settings, seed, source)
    fingerprint = {
        **{k: v for k, v in record.items() if k != "passes"},
        "views": [view.model_dump(mode="json") for view in views],
        "points": {name: dr.width(points.p) for name, points in renderer.points.items()},
        "training": [view.model_dump(mode="json") for view in work.views.train],
    }
    folder, passes = work.parts("reference", group), work.params.reference.passes
    parts = PassParts(folder, fingerprint, passes, "reference")
    return LongSum(work, group, renderer, parts, job.costs)


def views_of(work: Workspace, group: str) -> tuple[View, ...]:
    """The views of a group."""
    if group == "more":
        return work.views.more[: max(images_of(work) - len(work.views.train), 0)]
    return work.views.train if group == "train" else work.views.novel


def record_of(job: Job, group: str) -> dict[str, Any]:
    """What all views of a group have in common."""
    work, section = job.work, job.work.params.reference
    share, imaged = 1.0, [view.name for view in views_of(work, group)]
    if group == "train":
        share, imaged = (
            share_of_pixels(work, section.view_points),
            imaged[: images_of(work)],
        )
    return group_record(work, group, job.settings, _group_seed(job, group), share, imaged)


def _group_seed(job: Job, group: str) -> int:
    return pass_seed(job.work.params.reference.seed, 0, stream=100 + GROUPS.index(group))


def share_of_pixels(work: Workspace, points: int) -> float:
    """The share of the training views' pixels that has so many points."""
    width, height = work.film_size
    return min(1.0, points / (len(work.views.train) * width * height))


def target_points(
    job: Job,
    views: Sequence[View],
    share: float,
    surfaces: int,
    seed: int,
    photons: Photons | None = None,
) -> dict[str, VisiblePoints]:
    """Fixed points of a share of the views' pixels, and at most so many samples of surfaces.

    The surfaces are where ``photons`` lie, by default twice as many as a pass has: there is to be
    a choice; and where cameras look.
    """
    work, scene, settings = job.work, job.scene, job.settings
    points = {
        v.name: fixed_points(scene, work.sensor(v), v.name, settings, seed, share) for v in views
    }
    if surfaces > 0:
        if photons is None:
            photons = job.collect(2 * settings.photons_per_pass, seed)
        outlook = job.lookout.outlook
        places = Places(photons)
        if outlook is not None:
            arrivals = job.arrivals(seed)
            places = Places(photons, outlook.points, arrivals, outlook.reject(arrivals))
        points[SURFACES] = sample_surface_points(
            places, surfaces, settings.initial_radius, scene_bounds(scene), seed
        )
    return points


def pass_settings(work: Workspace, scene: Any, lookout: Lookout) -> PassSettings:
    """Settings of the passes; what is automatic is measured.

    The number of paths by what they bring to where cameras look, the radius at the first training
    view.
    """
    section = work.params.reference
    paths = section.photons_per_pass
    if paths == "auto":
        paths = lookout.paths_for_passes(EQUAL_PATHS)
    radius = section.initial_radius
    if radius == "auto":
        # In steps of a fifth: another training view is no reason to render novel views again.
        measured = _measure_radius(work, scene, paths, lookout.source)
        radius = float(f"{2 ** (round(4 * np.log2(measured)) / 4):.4g}")
    return PassSettings(
        photons_per_pass=paths,
        initial_radius=radius,
        alpha=section.alpha,
        direct=section.direct,
        glossy_walks=section.glossy_walks,
        edge_correction=section.edge_correction,
        rr_depth=section.rr_depth,
    )


def _measure_radius(work: Workspace, scene: Any, paths: int, source: Source) -> float:
    section = work.params.reference
    seed = pass_seed(section.seed, 0, stream=1)
    film = sample_film(scene, work.sensor(work.views.train[0]), seed)
    return propose_radius(scene, film.points, paths, section.seed, source=source)
