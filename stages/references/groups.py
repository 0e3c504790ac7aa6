"""The groups of a scene's references: what each renders, and with what seeds.

Training views (their fixed visible points and samples of the scene's surfaces become targets),
novel views (the judges), novel views once more (the second reference: how well does SPPM agree with itself),
and more training views for systems that learn from pictures. Within a group the views share their
photons; between groups nothing is shared, or noise that the field learned would count as quality.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np

from gpf.core.random import Stream, pass_seed
from gpf.core.structs import VisiblePoints
from gpf.guiding.emission_plan import EmissionPlan
from gpf.scene.views import View
from gpf.sppm.pass_files import PassParts
from gpf.sppm.passes import PassSettings
from gpf.sppm.reference import ReferenceRenderer
from gpf.training.surface_points import share_of_pixels, target_points
from stages.common.costs import CostMeter
from stages.common.workspace import Workspace
from stages.references.long_sums import LongSum
from stages.references.records import group_record
from stages.references.views_with_images import images_of

GROUPS = {
    "train": Stream.TRAIN_GROUP,
    "novel": Stream.NOVEL_GROUP,
    "second_reference": Stream.SECOND_REFERENCE_GROUP,
    "more": Stream.MORE_GROUP,
}
"""Groups, and the random numbers of each."""


@dataclass(frozen=True)
class Job:
    """What all groups of one run have in common."""

    work: Workspace
    scene: Any
    plan: EmissionPlan
    settings: PassSettings
    costs: CostMeter
    drawn: dict[Any, dict[str, VisiblePoints]] = field(default_factory=dict)

    @classmethod
    def open(cls, work: Workspace) -> Job:
        """Load the scene, and measure what is automatic."""
        scene = work.load_scene()
        costs = CostMeter.load(work.cost("reference"))
        costs.parts.pop("radius", None)
        with costs.measure("radius"):
            plan = work.emission_plan(scene)
            sensor = work.sensor(work.views.train[0])
            settings = work.params.reference.measure(scene, sensor, plan)
        return cls(work, scene, plan, settings, costs)

    def target_points(self, views: Sequence[View], surfaces: int) -> dict[str, VisiblePoints]:
        """Fixed points of a share of the views' pixels, and at most so many samples of surfaces;
        drawn once."""
        key = tuple(view.name for view in views), surfaces
        if key not in self.drawn:
            sensors = {view.name: self.work.sensor(view) for view in views}
            share, seed = share_of_view_points(self.work), _group_seed(self, "train")
            self.costs.parts.pop("points", None)
            with self.costs.measure("points"):
                self.drawn[key] = target_points(
                    self.scene, sensors, self.plan, self.settings, share, surfaces, seed
                )
        return self.drawn[key]


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
        points = job.target_points(views, surfaces)
    sensors = {view.name: work.sensor(view) for view in views if view.name in record["imaged"]}
    source = job.plan.source
    renderer = ReferenceRenderer(job.scene, sensors, points, job.settings, seed, source)
    fingerprint = {
        **{k: v for k, v in record.items() if k != "passes"},
        "views": [view.model_dump(mode="json") for view in views],
        "points": {name: dr.width(points.p) for name, points in renderer.points.items()},
        "training": [view.model_dump(mode="json") for view in work.views.train],
    }
    folder, passes = work.parts("reference", group), work.params.reference.passes
    parts = PassParts(folder, fingerprint, passes)
    return LongSum(work, group, renderer, parts, job.costs)


def views_of(work: Workspace, group: str) -> tuple[View, ...]:
    """The views of a group."""
    if group == "more":
        return work.views.more[: max(images_of(work) - len(work.views.train), 0)]
    return work.views.train if group == "train" else work.views.novel


def record_of(job: Job, group: str) -> dict[str, Any]:
    """What all views of a group have in common."""
    work = job.work
    share, imaged = 1.0, [view.name for view in views_of(work, group)]
    if group == "train":
        share, imaged = (
            share_of_view_points(work),
            imaged[: images_of(work)],
        )
    return group_record(work, group, job.settings, _group_seed(job, group), share, imaged)


def _group_seed(job: Job, group: str) -> int:
    return pass_seed(job.work.params.reference.seed, 0, GROUPS[group])


def share_of_view_points(work: Workspace) -> float:
    """The share of the training views' pixels whose points are targets."""
    pixels = len(work.views.train) * int(np.prod(work.film_size))
    return share_of_pixels(work.params.reference.view_points, pixels)
