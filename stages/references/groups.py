"""Groups of a scene's reference views: what each renders, with which seed, into which files.

========================  ====================================================================
``train``                 the training views: targets at their visible points and on surfaces
``novel``                 the novel views: the references
``second_reference``      the novel views again, independently, to see how well SPPM agrees
                          with itself
``more``                  further training views, for systems that learn from images
========================  ====================================================================

Training views have images only if systems learn from them. The views of a group share their
photons. Groups share nothing: otherwise the field would learn the noise of the references, and that
would count as quality.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.files import read_tensors
from gpf.core.images import read_record
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import VisiblePoints
from gpf.guiding.emission_plan import EmissionPlan
from gpf.scene.views import View
from gpf.sppm.passes import PassSettings
from gpf.training.surface_points import surface_points
from gpf.training.targets import SURFACES
from stages.common.code import digest_of
from stages.common.costs import CostMeter
from stages.common.workspace import Workspace
from stages.references.group_passes import GroupPasses
from stages.references.pass_files import PassParts
from stages.references.renderer import ReferenceRenderer
from stages.references.view_samples import fixed_points
from stages.references.views_with_images import count_views_with_images

GROUPS = {
    "train": Stream.TRAIN_GROUP,
    "novel": Stream.NOVEL_GROUP,
    "second_reference": Stream.SECOND_REFERENCE_GROUP,
    "more": Stream.MORE_GROUP,
}
"""The groups in the order in which they are rendered, and the random numbers of each."""


@dataclass(frozen=True)
class Job:
    """What all groups of one run share.

    Attributes
    ----------
    plan: where photons are needed.
    settings: settings of the passes.
    drawn: cached results of :meth:`target_points`.
    """

    work: Workspace
    scene: Any
    plan: EmissionPlan
    settings: PassSettings
    costs: CostMeter
    drawn: dict[Any, dict[str, VisiblePoints]] = field(default_factory=dict)

    @classmethod
    def open(cls, work: Workspace) -> Job:
        """Load the scene, and measure the settings that are ``auto``."""
        scene = work.load_scene()
        costs = CostMeter.load(work.cost("reference"))
        costs.parts.pop("radius", None)
        with costs.measure("radius"):
            plan = work.emission_plan(scene)
            # Another training view must not change the references of the others.
            first = [work.sensor(view) for view in work.views.train[:1]]
            settings = work.params.reference.measure(scene, first, plan)
        return cls(work, scene, plan, settings, costs)

    def target_points(self, views: Sequence[View], surfaces: int) -> dict[str, VisiblePoints]:
        """Supervised points: visible points of training views, and at most ``surfaces`` samples of
        surfaces. They are drawn once; later calls return the same points."""
        key = tuple(view.name for view in views), surfaces
        if key not in self.drawn:
            sensors = {view.name: self.work.sensor(view) for view in views}
            share, seed = share_of_view_points(self.work), Group(self, "train").seed
            self.costs.parts.pop("points", None)
            with self.costs.measure("points"):
                points = {
                    name: fixed_points(self.scene, sensor, name, self.settings, seed, share)
                    for name, sensor in sensors.items()
                }
                if surfaces > 0:
                    points[SURFACES] = surface_points(
                        self.scene, self.plan, self.settings, surfaces, seed
                    )
                self.drawn[key] = points
        return self.drawn[key]


def share_of_view_points(work: Workspace) -> float:
    """The share of the training views' pixels whose visible points are targets."""
    pixels = len(work.views.train) * int(np.prod(work.film_size))
    return min(1.0, work.params.reference.view_points / pixels)


@dataclass(frozen=True)
class GroupRequest:
    """What to render of a group: the views with these names, and whether to render the samples of
    surfaces."""

    group: str
    views: tuple[str, ...]
    surfaces: bool

    def __bool__(self) -> bool:
        return bool(self.views) or self.surfaces


@dataclass(frozen=True)
class Group:
    """One of :data:`GROUPS`, and its files."""

    job: Job
    name: str

    @property
    def work(self) -> Workspace:
        """The files of the scene."""
        return self.job.work

    @cached_property
    def views(self) -> tuple[View, ...]:
        """All views of the group."""
        views = self.work.views
        if self.name == "more":
            return views.more[: max(count_views_with_images(self.work) - len(views.train), 0)]
        return views.train if self.name == "train" else views.novel

    @property
    def surface_points(self) -> int:
        """Largest number of samples of surfaces."""
        return self.work.params.reference.surface_points if self.name == "train" else 0

    @property
    def seed(self) -> int:
        """The seed of the group's random numbers."""
        return pass_seed(self.work.params.reference.seed, 0, GROUPS[self.name])

    def file(self, view: str) -> Path:
        """The file of a view."""
        work = self.work
        second = self.name == "second_reference"
        return work.second_reference(view) if second else work.reference(view)

    def open(self, request: GroupRequest) -> GroupPasses:
        """The passes of the requested views and points."""
        job, work = self.job, self.work
        views = [view for view in self.views if view.name in request.views]
        points = {}
        if self.name == "train":
            surfaces = self.surface_points if request.surfaces else 0
            points = job.target_points(views, surfaces)
        imaged = self.record["imaged"]
        sensors = {view.name: work.sensor(view) for view in views if view.name in imaged}
        source = job.plan.source
        renderer = ReferenceRenderer(job.scene, sensors, points, job.settings, self.seed, source)
        fingerprint = {
            **{k: v for k, v in self.record.items() if k != "passes"},
            "views": [view.model_dump(mode="json") for view in views],
            "points": {name: dr.width(points.p) for name, points in renderer.points.items()},
            "training": [view.model_dump(mode="json") for view in work.views.train],
        }
        passes = work.params.reference.passes
        parts = PassParts(work.pass_parts(self.name), fingerprint, passes)
        return GroupPasses(work, self.name, renderer, parts, job.costs)

    # --- records: the facts in each file that tell whether it is current ----------------------

    @cached_property
    def record(self) -> dict[str, Any]:
        """The facts that the files of the group share, as JSON values."""
        work, section = self.work, self.work.params.reference
        imaged = [view.name for view in self.views]
        training = self.name == "train"
        return {
            "group": self.name,
            "passes": section.passes,
            "target_psnr": section.target_psnr,
            "code": digest_of("reference"),
            "made_with": [mi.variant(), mi.__version__, dr.__version__],
            "scene": work.scene_digest,
            "size": list(work.film_size),
            "visible_region": work.params.visible_region.model_dump(),
            "share": share_of_view_points(work) if training else 1.0,
            "imaged": imaged[: count_views_with_images(work)] if training else imaged,
            **self.job.settings.model_dump(),
            "seed": self.seed,
        }

    def view_record(self, view: View) -> dict[str, Any]:
        """The facts of a view's file; they do not depend on which other views have images."""
        imaged = view.name in self.record["imaged"]
        return {**self.record, "imaged": imaged, "view": view.model_dump(mode="json")}

    def surface_record(self) -> dict[str, Any]:
        """The facts of the samples of surfaces, whose places depend on the training views."""
        shared = {k: v for k, v in self.record.items() if k not in ("share", "imaged")}
        views = [view.model_dump(mode="json") for view in self.work.views.train]
        return {**shared, "views": views, "surface_points": self.surface_points}

    def missing(self) -> GroupRequest:
        """The views, and the samples of surfaces, whose files are missing or out of date."""
        views = tuple(view.name for view in self.views if not self._is_current(view))
        surfaces = self.surface_points > 0 and not self._has_surfaces()
        return GroupRequest(self.name, views, surfaces)

    def _is_current(self, view: View) -> bool:
        found, needed = read_record(self.file(view.name)), self.view_record(view)
        if found is None:
            return False
        if found.get("imaged") is True:  # an image that nothing needs does no harm
            needed.pop("imaged")
        return bool(found.items() >= needed.items())

    def _has_surfaces(self) -> bool:
        if not self.work.surfaces.exists():
            return False
        try:
            _, metadata = read_tensors(self.work.surfaces, "surfaces")
        except UserError:
            return False
        return metadata == self.surface_record()

    def passes_done(self) -> int:
        """Number of passes in the files; fewer than requested if ``target_psnr`` was reached."""
        records = [read_record(self.file(view.name)) or {} for view in self.views]
        done = [record["passes_done"] for record in records if "passes_done" in record]
        return min(done, default=self.work.params.reference.passes)
