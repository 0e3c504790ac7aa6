"""Stage `reference`: SPPM references of all views, and the targets that training learns from.

Three groups of passes, each with a seed of its own: training views (their fixed visible points and
samples of the scene's surfaces become targets), novel views (the judges), and novel views once
more (the ceiling: how well does SPPM agree with itself). Within a group the views share their
photons; between groups nothing is shared, or noise that the field learned would count as quality.
A view whose file was made by the same scene, camera and parameters is left alone.
"""

from __future__ import annotations

import ast
import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import gpf
from gpf.artifacts import read_tensors, write_tensors
from gpf.emission import Source
from gpf.errors import UserError
from gpf.images import check_finite, read_exr, read_record, write_exr
from gpf.photon_map import collect_photons
from gpf.progressive import PassSettings, pass_seed, propose_radius, sample_film
from gpf.reference import ReferenceRenderer, fixed_points, settings_record
from gpf.structs import VisiblePoints, scene_bounds, to_numpy
from gpf.supervision import Targets
from gpf.surface_samples import sample_surface_points
from gpf.views import View
from metrics.worth import snapshot_passes
from stages.costs import CostMeter
from stages.lookout import Lookout
from stages.progress import progress_bar
from stages.workspace import Workspace

GROUPS = ("train", "novel", "ceiling")

# With `photons_per_pass: auto`, a pass is as good as so many paths that bring equal power.
EQUAL_PATHS = 50_000

# Name of the set of surface samples among the points of a group; no view can be called so.
SURFACES = "surfaces of the scene"


@dataclass(frozen=True)
class _Job:
    """What all groups of one run have in common."""

    work: Workspace
    scene: Any
    lookout: Lookout
    settings: PassSettings
    costs: CostMeter


def render_references(scene_name: str) -> None:
    """Render what is missing of the references, the ceiling and the targets."""
    work = Workspace.open(scene_name)
    scene = work.load_scene()
    costs = CostMeter.load(work.cost("reference"))
    costs.parts.pop("radius", None)
    with costs.measure("radius"):
        lookout = Lookout.open(work, scene)
        settings = pass_settings(work, scene, lookout)
    job = _Job(work, scene, lookout, settings, costs)
    rendered = [_render_group(job, group) for group in GROUPS]
    if any(rendered) or "seconds_per_target_pass" not in costs.facts:
        costs.parts.pop("probe", None)
        with costs.measure("probe"):
            costs.facts |= _time_passes(job)
    costs.facts |= settings_record(settings, work.params.reference.seed) | lookout.facts()
    costs.write(work.cost("reference"))


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
        rr_depth=section.rr_depth,
    )


def _time_passes(job: _Job) -> dict[str, float]:
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
        renderer.passes_done = int(t) - 1
        start = time.perf_counter()
        renderer.run_pass()
        seconds.append(time.perf_counter() - start)
    return float(np.mean(seconds[2:]))


def _target_points(
    job: _Job, views: Sequence[View], share: float, surfaces: bool, seed: int
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
    width, height = work.film_size
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(pass_seed(section.seed, 0, stream=1), width * height)
    film = sample_film(scene, work.sensor(work.views.train[0]), sampler)
    return propose_radius(scene, film.points, paths, section.seed, source=source)


def _render_group(job: _Job, group: str) -> bool:
    """Render what is missing of a group; whether anything was."""
    work, section = job.work, job.work.params.reference
    seed = pass_seed(section.seed, 0, stream=100 + GROUPS.index(group))
    record = {
        "group": group,
        "passes": section.passes,
        "code": code_digest(),
        "made_with": [mi.variant(), mi.__version__, dr.__version__],
        "scene": work.scene_digest,
        "size": list(work.film_size),
        "outlook": work.params.outlook.model_dump(),
        **settings_record(job.settings, seed),
    }
    views = work.views.train if group == "train" else work.views.novel
    share, imaged = 1.0, [view.name for view in views]
    if group == "train":
        share, imaged = _share(work), imaged[: section.training_images]
    record |= {"share": share, "imaged": imaged}
    missing = [view for view in views if not _is_current(work, group, view, record)]
    surfaces = group == "train" and section.surface_points > 0
    surfaces_missing = surfaces and not _has_surfaces(work, record)
    if missing or surfaces_missing:
        points = {}
        if group == "train":
            job.costs.parts.pop("points", None)
            with job.costs.measure("points"):
                points = _target_points(job, missing, share, surfaces_missing, seed)
        elif group == "novel":
            points = _target_points(job, missing, share, False, seed)
        sensors = {view.name: work.sensor(view) for view in missing if view.name in imaged}
        source = job.lookout.source
        renderer = ReferenceRenderer(job.scene, sensors, points, job.settings, seed, source)
        _accumulate(work, renderer, group, missing, record, job.costs)
    if group == "train":
        _collect_targets(work, views, surfaces)
    return bool(missing or surfaces_missing)


def _share(work: Workspace) -> float:
    """The share of the training views' pixels whose points are supervised."""
    width, height = work.film_size
    pixels = len(work.views.train) * width * height
    return min(1.0, work.params.reference.view_points / pixels)


def code_digest() -> str:
    """A hash of the code that decides what a reference looks like, without its comments."""
    names = (
        "density emission emission_guiding materials outlook photon_map photon_tracing pilot "
        "progressive reference spatial_hash structs surface_samples thinning views "
        "visible_points"
    )
    digest = hashlib.sha256()
    for name in names.split():
        source = (Path(gpf.__file__).parent / f"{name}.py").read_text(encoding="utf-8")
        tree = ast.parse(source)
        for node in ast.walk(tree):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                node.value.value = None  # a docstring
        digest.update(ast.dump(tree).encode())
    return digest.hexdigest()[:16]


def _view_record(record: dict[str, Any], view: View) -> dict[str, Any]:
    """What made a view's file; a view does not depend on which others have images."""
    imaged = view.name in record["imaged"]
    return {**record, "imaged": imaged, "view": view.model_dump(mode="json")}


def _is_current(work: Workspace, group: str, view: View, record: dict[str, Any]) -> bool:
    path = work.ceiling(view.name) if group == "ceiling" else work.reference(view.name)
    found = read_record(path)
    if found is None:
        return False
    needed = _view_record(record, view)
    if found.get("imaged") is True:  # an image that nobody needs does no harm
        needed.pop("imaged")
    return found.items() >= needed.items()


def _has_surfaces(work: Workspace, record: dict[str, Any]) -> bool:
    if not work.surfaces.exists():
        return False
    try:
        _, metadata = read_tensors(work.surfaces, "surfaces", "reference")
    except UserError:
        return False
    return metadata == _surface_record(work, record)


def _surface_record(work: Workspace, record: dict[str, Any]) -> dict[str, Any]:
    """What made the samples of the surfaces: they lie where the training views look."""
    apart = {key: value for key, value in record.items() if key not in ("share", "imaged")}
    views = [view.model_dump(mode="json") for view in work.views.train]
    return {**apart, "views": views, "surface_points": work.params.reference.surface_points}


def _accumulate(
    work: Workspace,
    renderer: ReferenceRenderer,
    group: str,
    views: Sequence[View],
    record: dict[str, Any],
    costs: CostMeter,
) -> None:
    """Run the passes of a group, with checkpoints, and write its files."""
    section = work.params.reference
    snapshots = snapshot_passes(section.passes) if group == "ceiling" else []
    fingerprint = {
        **record,
        "views": [view.model_dump(mode="json") for view in views],
        "points": {name: dr.width(points.p) for name, points in renderer.points.items()},
        "training": [view.model_dump(mode="json") for view in work.views.train],
    }
    checkpoint = work.checkpoint("reference", group)
    spent = renderer.restore(checkpoint, fingerprint)
    if spent:
        costs.parts[group] = spent
    saved = time.monotonic()

    title = f"{work.scene}: {group} references"
    with progress_bar(title, section.passes) as advance, costs.measure(group):
        while renderer.passes_done < section.passes:
            renderer.run_pass()
            done = renderer.passes_done
            advance(done)
            if done in snapshots:
                renderer.take_snapshot()
            if done < section.passes and time.monotonic() - saved > section.checkpoint_seconds:
                renderer.save(checkpoint, fingerprint, costs.so_far(group))
                saved = time.monotonic()

    costs.share(group, sorted({*renderer.sensors, *renderer.points}))
    for view in views:
        if group == "ceiling":
            path, layers = work.ceiling(view.name), renderer.snapshots[view.name]
        else:
            path, layers = (
                work.reference(view.name),
                renderer.view(view.name, work.film_size).layers(),
            )
        for name, image in layers.items():
            if image.ndim == 3:
                check_finite(image, f"{work.scene}, view {view.name}, {name}")
        write_exr(path, layers, _view_record(record, view))
    if SURFACES in renderer.points:
        points = renderer.points[SURFACES]
        check_finite(renderer.mean_irradiance(SURFACES), f"{work.scene}, samples of its surfaces")
        tensors = {
            "position": to_numpy(points.p),
            "normal": to_numpy(points.n),
            "irradiance": renderer.mean_irradiance(SURFACES),
        }
        write_tensors(work.surfaces, "surfaces", tensors, _surface_record(work, record))
    checkpoint.unlink(missing_ok=True)


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
