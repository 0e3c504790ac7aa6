"""Stage `reference`: SPPM references of all views, and the targets that training learns from.

Three groups of passes, each with a seed of its own: training views (their fixed visible points and
samples of the scene's surfaces become targets), novel views (the judges), and novel views once
more (the ceiling: how well does SPPM agree with itself). Within a group the views share their
photons; between groups nothing is shared, or noise that the field learned would count as quality.
A view whose file was made by the same scene, camera and parameters is left alone.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from gpf.artifacts import read_tensors, write_tensors
from gpf.emission import Source
from gpf.errors import UserError
from gpf.film import sample_film
from gpf.images import check_finite, read_exr, write_exr
from gpf.pass_parts import PassParts
from gpf.photon_map import collect_photons
from gpf.progressive import PassSettings, pass_seed, propose_radius
from gpf.reference import ReferenceRenderer, fixed_points, settings_record
from gpf.structs import VisiblePoints, scene_bounds, to_numpy
from gpf.supervision import Targets
from gpf.surface_samples import sample_surface_points
from gpf.views import View
from metrics.worth import snapshot_passes
from stages.costs import CostMeter
from stages.lookout import Lookout
from stages.passes import SURFACES, LongSum
from stages.progress import console
from stages.reference_records import (
    group_record,
    has_surfaces,
    is_current,
    surface_record,
    view_record,
)
from stages.workspace import Workspace

GROUPS = ("train", "novel", "ceiling")

# With `photons_per_pass: auto`, a pass is as good as so many paths that bring equal power.
EQUAL_PATHS = 50_000


@dataclass(frozen=True)
class Job:
    """What all groups of one run have in common."""

    work: Workspace
    scene: Any
    lookout: Lookout
    settings: PassSettings
    costs: CostMeter

    @classmethod
    def open(cls, scene_name: str) -> Job:
        """Load the scene, and measure what is automatic."""
        work = Workspace.open(scene_name)
        scene = work.load_scene()
        costs = CostMeter.load(work.cost("reference"))
        costs.parts.pop("radius", None)
        with costs.measure("radius"):
            lookout = Lookout.open(work, scene)
            settings = pass_settings(work, scene, lookout)
        return cls(work, scene, lookout, settings, costs)


@dataclass(frozen=True)
class GroupRequest:
    """What is to be rendered of a group: the views with these names, and surface samples or not."""

    group: str
    views: tuple[str, ...]
    surfaces: bool


def render_references(scene_name: str, passes: str | None = None) -> None:
    """Render what is missing of the references, the ceiling and the targets.

    ``passes``, written ``FIRST:LAST``, limits that to a range of passes, which other runs or other
    machines complete; files are written once all passes are there.
    """
    job = Job.open(scene_name)
    work, costs = job.work, job.costs
    wanted = _parse_range(passes, work.params.reference.passes) if passes else None
    rendered = [_render_group(job, group, wanted) for group in GROUPS]
    if None in rendered:
        missing = ", ".join(g for g, state in zip(GROUPS, rendered, strict=True) if state is None)
        console.print(
            f"{scene_name}: passes {passes} are done, others are missing ({missing}); bring their "
            "files here, or run the stage without --passes",
            highlight=False,
        )
        return
    if any(rendered) or "seconds_per_target_pass" not in costs.facts:
        costs.parts.pop("probe", None)
        with costs.measure("probe"):
            costs.facts |= _time_passes(job)
    costs.facts |= settings_record(job.settings, work.params.reference.seed) | job.lookout.facts()
    costs.write(work.cost("reference"))


def _parse_range(text: str, passes: int) -> range:
    """``FIRST:LAST`` like a slice; both ends may be left out."""
    first, colon, last = text.partition(":")
    numbers = (first or "0", last or str(passes))
    if not colon or not all(number.isdecimal() for number in numbers):
        raise UserError(
            f"--passes {text}", "is no range of passes", "Write it as FIRST:LAST, such as 0:250."
        )
    found = range(int(numbers[0]), int(numbers[1]))
    if not found or found.stop > passes:
        raise UserError(
            f"--passes {text}",
            f"is not within the {passes} passes of params.yaml",
            "Give a range within them, or change reference.passes.",
        )
    return found


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
        rr_depth=section.rr_depth,
    )


def _time_passes(job: Job) -> dict[str, float]:
    """What a pass costs for one view's image alone, and for the field's targets alone.

    The stage's own passes serve both at once, and several views.
    """
    section = job.work.params.reference
    view = job.work.views.train[0]
    sensor = {view.name: job.work.sensor(view)}
    points = _target_points(job, job.work.views.train, _share(job.work), True, section.seed)
    source, settings, seed = job.lookout.source, job.settings, section.seed
    alone = ReferenceRenderer(job.scene, sensor, {}, settings, seed, source)
    targets = ReferenceRenderer(job.scene, {}, points, settings, seed, source)
    passes = section.passes
    return {
        "seconds_per_single_view_pass": _seconds_per_pass(alone, passes),
        "seconds_per_target_pass": _seconds_per_pass(targets, passes),
    }


def _seconds_per_pass(renderer: ReferenceRenderer, passes: int, samples: int = 12) -> float:
    """Mean over samples spread evenly over all passes: a pass gets cheaper as its radius shrinks.

    The first two are not counted: they may compile.
    """
    seconds = []
    for t in [1, 1, *np.linspace(1, passes, samples).astype(int)]:
        start = time.perf_counter()
        renderer.run_pass(int(t))
        seconds.append(time.perf_counter() - start)
    return float(np.mean(seconds[2:]))


def _target_points(
    job: Job, views: Sequence[View], share: float, surfaces: bool, seed: int
) -> dict[str, VisiblePoints]:
    """Fixed points of views, and samples of the surfaces where they are asked for."""
    work, scene, settings = job.work, job.scene, job.settings
    points = {
        v.name: fixed_points(scene, work.sensor(v), v.name, settings, seed, share) for v in views
    }
    count = work.params.reference.surface_points
    if surfaces and count > 0:
        # Twice as many photons as a pass has: there is to be a choice.
        paths = 2 * settings.photons_per_pass
        lookout = job.lookout
        photons = collect_photons(
            scene, lookout.outlook, paths, seed, settings.rr_depth, lookout.source
        )
        points[SURFACES] = sample_surface_points(
            photons, count, settings.initial_radius, scene_bounds(scene), seed
        )
    return points


def _measure_radius(work: Workspace, scene: Any, paths: int, source: Source) -> float:
    section = work.params.reference
    seed = pass_seed(section.seed, 0, stream=1)
    film = sample_film(scene, work.sensor(work.views.train[0]), seed)
    return propose_radius(scene, film.points, paths, section.seed, source=source)


def _render_group(job: Job, group: str, wanted: range | None) -> bool | None:
    """Render what is missing of a group; whether anything was. None: passes are still missing."""
    work = job.work
    record = _record(job, group)
    views = work.views.train if group == "train" else work.views.novel
    missing = [view for view in views if not is_current(work, group, view, record)]
    surfaces = group == "train" and work.params.reference.surface_points > 0
    surfaces_missing = surfaces and not has_surfaces(work, record)
    if missing or surfaces_missing:
        request = GroupRequest(group, tuple(view.name for view in missing), surfaces_missing)
        passes = open_group(job, request)
        for other in passes.parts.others():
            console.print(
                f"{passes.parts.parent / other}: passes of other parameters or code; left alone",
                highlight=False,
            )
        wanted = range(passes.passes) if wanted is None else wanted
        if work.params.executor == "ray":
            # Here alone: Ray is optional, and slow to import.
            from stages.cluster import render_on_cluster

            render_on_cluster(passes, request, wanted)
        else:
            passes.render(wanted)
        if not passes.is_complete():
            return None
        _write_group(passes, missing, record)
    if group == "train":
        _collect_targets(work, views, surfaces)
    return bool(missing or surfaces_missing)


def _record(job: Job, group: str) -> dict[str, Any]:
    work, section = job.work, job.work.params.reference
    views = work.views.train if group == "train" else work.views.novel
    share, imaged = 1.0, [view.name for view in views]
    if group == "train":
        share, imaged = _share(work), imaged[: section.training_images]
    return group_record(work, group, job.settings, _group_seed(job, group), share, imaged)


def _group_seed(job: Job, group: str) -> int:
    return pass_seed(job.work.params.reference.seed, 0, stream=100 + GROUPS.index(group))


def open_group(job: Job, request: GroupRequest) -> LongSum:
    """The passes of a group: what renders them, and the parts that are done."""
    work, group = job.work, request.group
    record, seed = _record(job, group), _group_seed(job, group)
    views = [v for v in (*work.views.train, *work.views.novel) if v.name in request.views]
    points = {}
    if group == "train":
        job.costs.parts.pop("points", None)
        with job.costs.measure("points"):
            points = _target_points(job, views, record["share"], request.surfaces, seed)
    elif group == "novel":
        points = _target_points(job, views, record["share"], False, seed)
    sensors = {view.name: work.sensor(view) for view in views if view.name in record["imaged"]}
    source = job.lookout.source
    renderer = ReferenceRenderer(job.scene, sensors, points, job.settings, seed, source)
    fingerprint = {
        **{key: value for key, value in record.items() if key != "passes"},
        "views": [view.model_dump(mode="json") for view in views],
        "points": {name: dr.width(points.p) for name, points in renderer.points.items()},
        "training": [view.model_dump(mode="json") for view in work.views.train],
    }
    parts = PassParts(work.parts("reference", group), fingerprint, "reference")
    return LongSum(work, group, renderer, parts, job.costs)


def _share(work: Workspace) -> float:
    """The share of the training views' pixels whose points are supervised."""
    width, height = work.film_size
    pixels = len(work.views.train) * width * height
    return min(1.0, work.params.reference.view_points / pixels)


def _write_group(passes: LongSum, views: Sequence[View], record: dict[str, Any]) -> None:
    """Write the files of a group whose passes are all there, and forget the parts."""
    work, group, renderer = passes.work, passes.group, passes.renderer
    snapshots = passes.finish(snapshot_passes(passes.passes) if group == "ceiling" else [])
    passes.costs.share(group, sorted({*renderer.sensors, *renderer.points}))
    for view in views:
        if group == "ceiling":
            path, layers = work.ceiling(view.name), snapshots[view.name]
        else:
            path = work.reference(view.name)
            layers = renderer.view(view.name, work.film_size).layers()
        for name, image in layers.items():
            if image.ndim == 3:
                check_finite(image, f"{work.scene}, view {view.name}, {name}")
        write_exr(path, layers, view_record(record, view) | _noise(passes, view.name))
    if SURFACES in renderer.points:
        points = renderer.points[SURFACES]
        tensors = {
            "position": to_numpy(points.p),
            "normal": to_numpy(points.n),
            "irradiance": renderer.mean_irradiance(SURFACES),
        }
        write_tensors(work.surfaces, "surfaces", tensors, surface_record(work, record))
    passes.parts.clear()
    work.forget_checkpoints()


def _noise(passes: LongSum, view: str) -> dict[str, Any]:
    """How much noise is left in a view's image, for its record."""
    sums = passes.renderer.sums
    if view not in sums.views:
        return {}
    tally = sums.views[view]
    error, mean = tally.standard_error(sums.passes), tally.mean(sums.passes)
    return {
        "passes_done": sums.passes,
        "standard_error": float(np.sqrt(np.mean(error**2)) / max(np.mean(mean), 1e-30)),
        "estimated_ceiling": tally.ceiling(sums.passes, passes.work.views.exposure),
    }


def _collect_targets(work: Workspace, views: Sequence[View], surfaces: bool) -> None:
    """Write the supervised points of all training views and surfaces into one file."""
    parts = []
    for k, view in enumerate(views):
        layers, _ = read_exr(work.reference(view.name), "reference")
        parts.append(Targets.from_view(layers, k))
    if surfaces:
        tensors, _ = read_tensors(work.surfaces, "surfaces", "reference")
        parts.append(Targets.from_surfaces(tensors))
    Targets.join(parts).save(work.targets)
