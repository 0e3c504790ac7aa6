"""Stage `animate`: the camera path rendered by several methods side by side, and their flicker.

Each method renders with its usual settings; one that learns uses the state that `gpf stage
baseline` saved. Frames are saved one by one, so that an interrupted run can be resumed. References
of the frames are not rendered, because they would cost many times as much as those of the novel
views. Flicker is measured without references (:mod:`metrics.flicker`). The flicker that the noise
of references would cause is computed from the standard errors of the novel views.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from baselines.protocol import CannotServe
from gpf.core.errors import UserError
from gpf.core.files import write_json
from gpf.core.films import write_film
from gpf.core.images import check_finite, read_exr, read_record, tone_map, write_exr
from gpf.core.progress import Bar, progress_bar, say
from gpf.core.yaml import suggest
from gpf.scene.views import View
from stages.animation.filmstrip import (
    Reel,
    compose,
    film_panel,
    webp_panel,
    write_webp,
)
from stages.animation.frame_flicker import compare_frames
from stages.baseline import forget_state, open_state, prepare, refuse_other_scenes
from stages.common.code import digest_of
from stages.common.costs import CostMeter
from stages.common.workspace import Workspace
from stages.config.titles import method_titles
from stages.render import open_renderer

FIELD = "gpf"

Draw = Callable[[View, int], np.ndarray]


def run(scene_name: str) -> None:
    """Render the missing frames of the path; write the films and the flicker.

    Does nothing for a scene that is not in `animation.scenes`.
    """
    work = Workspace.open(scene_name)
    section = work.params.animation
    if scene_name not in section.scenes:
        say(f"{scene_name}: skipped, because animation.scenes in params.yaml does not list it")
        return
    views = work.views.frames()
    if not views:
        raise UserError(
            str(work.views_file),
            "has no camera path",
            "Add a path; gpf/scene/views.py describes it.",
        )
    costs, refusals = CostMeter(), {}
    for method in section.methods:
        try:
            render_frames(work, method, views, costs)
        except CannotServe as refusal:
            shutil.rmtree(frame(work, method, 0).parent, ignore_errors=True)
            refusals[method] = refusal.what
            say(f"{scene_name}, {method}: {refusal}")
        forget_state_of(work, method)
    forget_others(work, section.methods, len(views))
    shown = [m for m in section.methods if m not in refusals]
    with costs.measure("flicker"):
        files = {m: [frame(work, m, k) for k in range(len(views))] for m in shown}
        flicker = compare_frames(work, files, views)
    flicker["methods"] |= {m: {"cannot_serve": why} for m, why in refusals.items()}
    write_json(work.folder / "flicker.json", flicker)
    with costs.measure("film"):
        write_films(work, refusals, len(views))
    costs.facts["frames"] = len(views)
    costs.write(work.cost("animate"))
    for method in shown:
        changes = ", ".join(
            f"{numbers['change']:.2f} of 255 ({where})"
            for where, numbers in flicker["methods"][method].items()
        )
        say(f"{scene_name}, {method}: flicker {changes or 'not measured'}")


def frame(work: Workspace, method: str, number: int) -> Path:
    """A method's image of a frame."""
    return work.folder / "animation" / method / f"{number:02d}.exr"


def render_frames(work: Workspace, method: str, views: Sequence[View], costs: CostMeter) -> None:
    """Render the frames of a method that are missing or out of date."""
    task, open_method = plan(work, method)
    records = [{**task, "view": view.model_dump(mode="json")} for view in views]
    missing = [k for k, record in enumerate(records) if not is_current(work, method, k, record)]
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


def is_current(work: Workspace, method: str, number: int, record: dict[str, Any]) -> bool:
    """Whether the file of a frame has this record."""
    found = read_record(frame(work, method, number)) or {}
    found.pop("schema_version", None)
    return bool(found == json.loads(json.dumps(record)))


def plan(work: Workspace, method: str) -> tuple[dict[str, Any], Callable[[Bar], Draw]]:
    """The facts that a method's frames depend on, and a function that prepares the method.

    Raises
    ------
    CannotServe: the method is not meant for the scene.
    UserError: there is no such method.
    """
    params = work.params
    if method == FIELD:
        task = {
            "code": digest_of("render"),
            "render": params.render.model_dump(mode="json"),
            "field": work.digest(work.field),
        }

        def open_field(bar: Bar) -> Draw:
            renderer = open_renderer(work, params.render.spp)
            return lambda view, seed: renderer.render(view, work.film_size, seed)["radiance"]

        open_method = open_field
    elif method in params.baselines:
        options = params.baselines[method]
        refuse_other_scenes(work, method, options)
        state = open_state(work, method, options)
        task = {"task": work.digest(state / "task.json")}

        def open_baseline(bar: Bar) -> Draw:
            prepared, _ = prepare(work, method, options, bar)
            return prepared.render

        open_method = open_baseline
    else:
        todo = suggest(method, [FIELD, *params.baselines], "Methods are")
        raise UserError(f"params.yaml: animation.methods: {method!r}", "does not exist", todo)
    size = list(work.film_size)
    return {"method": method, "scene": work.scene_digest, "size": size, **task}, open_method


def forget_state_of(work: Workspace, method: str) -> None:
    """Remove the state of a method that does not learn; learned states save time in later runs."""
    options = work.params.baselines.get(method)
    if options and not options.learns:
        forget_state(work, method)


def forget_others(work: Workspace, methods: Sequence[str], frames: int) -> None:
    """Remove frames of methods no longer in params.yaml, and those beyond the end of the path."""
    for folder in (work.folder / "animation").glob("*/"):
        if folder.name not in methods:
            shutil.rmtree(folder)
            continue
        known = {frame(work, folder.name, k) for k in range(frames)}
        for file in set(folder.glob("*.exr")) - known:
            file.unlink()


def write_films(work: Workspace, refusals: dict[str, str], count: int) -> None:
    """Write all methods side by side, as an MP4 and as an animated WebP."""
    reels = []
    for method in work.params.animation.methods:
        frames = []
        if method not in refusals:
            for k in range(count):
                image = read_exr(frame(work, method, k))[0]["radiance"]
                shown = tone_map(image, work.views.exposure)
                frames.append(np.round(shown * 255).astype(np.uint8))
        reels.append(Reel(method_titles(work.params)[method], frames, refusals.get(method, "")))
    folder, fps = work.folder / "animation", work.params.animation.fps
    if not any(reel.frames for reel in reels):
        raise UserError(
            "params.yaml: animation.methods",
            f"lists no method that can serve {work.scene}",
            "List one that can.",
        )
    webp = compose(reels, webp_panel(work.film_size, len(reels)))
    write_webp(folder / "animation.webp", webp, fps)
    film = [np.asarray(sheet) for sheet in compose(reels, film_panel(work.film_size))]
    write_film(folder / "animation.mp4", film, fps)
