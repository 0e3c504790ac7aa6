"""Stage `animate`: the camera path by several methods side by side, and how much each flickers.

Every method renders with what it has: its own samples, and the state that `gpf stage baseline`
left of what it learned. Frames are kept one by one, so that a run that was killed goes on. What the
path looks like in a reference is not rendered: it would cost as much as all novel views many times
over. Flicker needs none (:mod:`metrics.flicker`); by how much the noise of a reference would
flicker is told from the standard errors of the novel views.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.artifacts import write_json
from gpf.baselines.protocol import CannotServe
from gpf.baselines.registry import make_baseline
from gpf.errors import UserError
from gpf.images import check_finite, read_exr, read_record, tone_map, write_exr
from gpf.views import View
from gpf.yaml_files import suggest
from metrics.flicker import (
    FramePoints,
    change_of_noise,
    link_frames,
    measure_flicker,
    smooth_pixels,
)
from stages.baseline import forget_state, make_task, open_state, refuse_other_scenes
from stages.code_digest import library_digest
from stages.costs import CostMeter
from stages.filmstrip import (
    Reel,
    compose,
    film_panel,
    picture_panel,
    write_film,
    write_moving_picture,
)
from stages.frame_points import see_points
from stages.progress import Bar, console, progress_bar
from stages.render import FieldRenderer
from stages.workspace import Workspace

FIELD = "gpf"

WAYS = ("directly", "refracted")
"""How surfaces are seen whose flicker is told; named as in :class:`SeenPoints`."""

Draw = Callable[[View, int], np.ndarray]


def animate(scene_name: str) -> None:
    """Render the frames of the path that are missing, and write film, picture and flicker.

    Of a scene that `animation.scenes` does not list, nothing is made.
    """
    work = Workspace.open(scene_name)
    section = work.params.animation
    if scene_name not in section.scenes:
        console.print(
            f"{scene_name}: not asked for; animation.scenes in params.yaml does not list it",
            highlight=False,
        )
        return
    views = work.views.frames()
    if not views:
        raise UserError(
            str(work.views_file), "has no camera path", "Add a path; gpf/views.py describes it."
        )
    costs, refusals = CostMeter(), {}
    for method in section.methods:
        try:
            render_frames(work, method, views, costs)
        except CannotServe as refusal:
            shutil.rmtree(frame(work, method, 0).parent, ignore_errors=True)
            refusals[method] = refusal.what
            console.print(f"{scene_name}, {method}: {refusal}", highlight=False, soft_wrap=True)
        forget_state_of(work, method)
    forget_others(work, section.methods)
    shown = [m for m in section.methods if m not in refusals]
    with costs.measure("flicker"):
        flicker = compare_frames(work, shown, views)
    flicker["methods"] |= {m: {"cannot_serve": why} for m, why in refusals.items()}
    write_json(work.folder / "animation" / "flicker.json", flicker)
    with costs.measure("film"):
        write_films(work, refusals, len(views))
    costs.facts["frames"] = len(views)
    costs.write(work.cost("animate"))
    for method in shown:
        told = ", ".join(
            f"{numbers['change']:.2f} of 255 ({where})"
            for where, numbers in flicker["methods"][method].items()
        )
        console.print(f"{scene_name}, {method}: flicker {told or 'not measured'}", highlight=False)


def frame(work: Workspace, method: str, number: int) -> Path:
    """A method's image of a frame."""
    return work.folder / "animation" / method / f"{number:02d}.exr"


def render_frames(work: Workspace, method: str, views: Sequence[View], costs: CostMeter) -> None:
    """Render the frames of a method that are not there, or not as they should be."""
    task, open_method = plan(work, method)
    records = [{**task, "view": view.model_dump(mode="json")} for view in views]
    missing = [k for k, record in enumerate(records) if not is_kept(work, method, k, record)]
    if not missing:
        return
    with progress_bar(f"{work.scene}: {method}, frames", len(views)) as bar:
        with costs.measure(f"prepare/{method}"):
            draw = open_method(bar)
        for done, k in enumerate(missing, start=len(views) - len(missing)):
            bar(done, len(views))
            with costs.measure(f"render/{method}"):
                image = draw(views[k], work.params.render.seed + k)
            check_finite(image, f"{work.scene}, {method}, frame {k}")
            layers = {"radiance": image.astype(np.float32)}
            write_exr(frame(work, method, k), layers, records[k])
        bar(len(views), len(views))


def is_kept(work: Workspace, method: str, number: int, record: dict[str, Any]) -> bool:
    """Whether an earlier run has left a frame with just this record."""
    found = read_record(frame(work, method, number)) or {}
    found.pop("schema_version", None)
    return bool(found == json.loads(json.dumps(record)))


def plan(work: Workspace, method: str) -> tuple[dict[str, Any], Callable[[Bar], Draw]]:
    """What a method's frames depend on, and what makes it ready to render them."""
    params = work.params
    if method == FIELD:
        task = {
            "code": library_digest(),
            "render": params.render.model_dump(mode="json"),
            "field": work.digest(work.field),
        }

        def open_field(bar: Bar) -> Draw:
            renderer = FieldRenderer.open(work, params.film.height, params.render.spp)
            return lambda view, seed: renderer.render(view, seed).radiance

        open_method = open_field
    elif method in params.baselines:
        options = params.baselines[method]
        refuse_other_scenes(work, method, options)
        state = open_state(work, method, options)
        task = {"task": work.digest(state / "task.json")}

        def open_baseline(bar: Bar) -> Draw:
            prepared = make_baseline(options).prepare(make_task(work, options, state, bar))
            return prepared.render

        open_method = open_baseline
    else:
        todo = suggest(method, [FIELD, *params.baselines], "There are")
        raise UserError(f"params.yaml: animation.methods: {method!r}", "does not exist", todo)
    size = list(work.film_size)
    return {"method": method, "scene": work.scene_digest, "size": size, **task}, open_method


def forget_state_of(work: Workspace, method: str) -> None:
    """Remove the state of a system that learns nothing; of others it spares a further run much."""
    options = work.params.baselines.get(method)
    if options and not options.training_views and not options.learns_from_targets:
        forget_state(work, method)


def forget_others(work: Workspace, methods: Sequence[str]) -> None:
    """Remove frames of methods that params.yaml does not list any more."""
    for folder in (work.folder / "animation").glob("*/"):
        if folder.name not in methods:
            shutil.rmtree(folder)


def compare_frames(
    work: Workspace, methods: Sequence[str], views: Sequence[View]
) -> dict[str, Any]:
    """Flicker of each method on surfaces that are seen directly, and through water or glass."""
    scene, closed = work.load_scene(), bool(work.views.path and work.views.path.closed)
    seen = [see_ways(scene, view, work) for view in views]
    links = {}
    for way in WAYS:
        points = [ways[way] for ways in seen]
        steps = list(zip(points, [*points[1:], points[0]], strict=True))
        found = [link_frames(a, b) for a, b in (steps if closed else steps[:-1])]
        if any(len(link.later) for link in found):
            links[way] = found
    told: dict[str, dict[str, Any]] = {}
    for method in methods:
        images = [
            read_exr(frame(work, method, k), "animate")[0]["radiance"] for k in range(len(views))
        ]
        told[method] = {}
        for way, found in links.items():
            flicker = measure_flicker(images, found, work.views.exposure)
            told[method][way] = {**asdict(flicker), "noise": flicker.noise}
    return {
        "unit": "levels of 255",
        "frames": len(views),
        "methods": told,
        "noise_of_references": noise_of_references(work, scene),
    }


def see_ways(scene: mi.Scene, view: View, work: Workspace) -> dict[str, FramePoints]:
    """What a view's pixels see in each of :data:`WAYS`."""
    seen = see_points(scene, view, work.film_size)
    return {way: FramePoints(seen.points, getattr(seen, way)) for way in WAYS}


def noise_of_references(work: Workspace, scene: mi.Scene) -> dict[str, dict[str, float]]:
    """What references of the path would change by, from their noise alone.

    It is told in the novel views, in pixels of the kinds in which methods are measured; ``share``
    is that of these pixels.
    """
    found: dict[str, list[np.ndarray]] = {way: [] for way in WAYS}
    noise: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {way: [] for way in WAYS}
    for view in work.views.novel:
        path = work.reference(view.name)
        layers = read_exr(path, "reference")[0] if path.exists() else {}
        if "standard_error" in layers:
            for way, points in see_ways(scene, view, work).items():
                kept = smooth_pixels(points)
                found[way].append(kept)
                noise[way].append((layers["radiance"][kept], layers["standard_error"][kept]))
    told = {}
    for way in WAYS:
        if np.any(found[way]):
            radiance, error = (np.concatenate(part) for part in zip(*noise[way], strict=True))
            change = change_of_noise(radiance, error, work.views.exposure)
            told[way] = {"change": change, "share": float(np.mean(found[way]))}
    return told


def write_films(work: Workspace, refusals: dict[str, str], count: int) -> None:
    """All methods side by side: as an MP4, and as a picture that moves."""
    reels = []
    for method in work.params.animation.methods:
        frames = []
        if method not in refusals:
            for k in range(count):
                image = read_exr(frame(work, method, k), "animate")[0]["radiance"]
                shown = tone_map(image, work.views.exposure)
                frames.append(np.round(shown * 255).astype(np.uint8))
        reels.append(Reel(title(work, method), frames, refusals.get(method, "")))
    folder, fps = work.folder / "animation", work.params.animation.fps
    if not any(reel.frames for reel in reels):
        raise UserError(
            "params.yaml: animation.methods",
            f"none of them can serve {work.scene}",
            "List one that can.",
        )
    picture = compose(reels, picture_panel(work.film_size, len(reels)))
    write_moving_picture(folder / "animation.webp", picture, fps)
    write_film(folder / "animation.mp4", compose(reels, film_panel(work.film_size)), fps)


def title(work: Workspace, method: str) -> str:
    """What people are shown for a method."""
    if method == FIELD:
        return f"GPF, {work.params.render.spp} spp"
    return work.params.baselines[method].title
