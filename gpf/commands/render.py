"""`gpf render`: pictures of any views of a scene, from a field."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from gpf.commands.cameras import CameraChoice, Cameras
from gpf.commands.data_set import write_data_set, write_layers
from gpf.commands.overwriting import require_new
from gpf.commands.picture_options import PictureOptions
from gpf.commands.pictures import Pictures, Rendering
from gpf.commands.shots import Shot, find_shots
from gpf.core.errors import UserError
from gpf.core.images import propose_exposure
from gpf.core.locks import sole_run
from gpf.core.partial import remove_leftovers
from gpf.core.progress import Bar, progress_bar, say
from gpf.core.random import pass_seed, stream_of
from gpf.core.runtime import choose_variant
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.lights import set_lights
from gpf.scene.fingerprint import fingerprint
from gpf.scene.untraceable import telling_untraceable
from gpf.scene.views import View


def render_pictures(
    scene_name: str,
    field_file: Path | None,
    choice: CameraChoice,
    folder: Path | None,
    options: PictureOptions,
) -> None:
    """Render views as ``NAME.exr`` and ``NAME.png``, and write ``transforms.json``.

    Pictures that exist and were made in the same way are kept; others are replaced only with
    ``options.overwrite``.

    Parameters
    ----------
    scene_name, field_file: as for :func:`gpf.commands.shots.find_shots`.
    folder: by default ``pictures``, or that of the trained scene.

    Raises
    ------
    UserError: a file, a view or an option is wrong, or the field is for another scene.
    """
    options.check()
    shots, usual = find_shots(scene_name, field_file, choice)
    folder = folder or usual
    choose_variant("auto")
    opened = _Opened.of(shots[0], options)
    exposure, layers = opened.exposure(options), options.layers()
    size, total = opened.size, len(shots) * len(opened.cameras.views)
    views: list[View] = []
    start, made = time.perf_counter(), 0
    with (
        sole_run(folder, inside=True),
        telling_untraceable(scene_name),
        progress_bar(f"{folder.name}: rendering", total) as bar,
    ):
        remove_leftovers(folder)
        for shot in shots:
            if shot is not shots[0]:
                opened = _Opened.of(shot, options)
            own = opened.cameras.views
            pictures = Pictures(folder, own, layers, exposure, opened.facts(options))
            for view in own:
                if pictures.is_another(view):
                    require_new(pictures.exr(view), options.overwrite, "give another folder")
            render = partial(_render, opened, options)
            made += pictures.render(render, partial(_count, bar, len(views)))
            write_layers(folder, opened.renderer.scene, own, size, layers)
            views += own
        whole = Pictures(folder, tuple(views), layers, exposure, {})
        if options.film:
            whole.write_film()
        times = {shot.frame.name: shot.frame.time for shot in shots if shot.frame is not None}
        write_data_set(folder, views, size, layers, times)
    for remark in whole.remarks():
        say(f"{folder}: {remark}")
    kept = len(views) - made
    seconds = (time.perf_counter() - start) / max(made, 1)
    notes = [f"{made} picture{'s' if made != 1 else ''}, {seconds:.2f} s each"] if made else []
    notes += [f"{kept} already done"] if kept else []
    say(f"{folder}: {'; '.join(notes)}")


def _count(bar: Bar, before: int, done: int) -> None:
    bar(before + done)


@dataclass(frozen=True)
class _Opened:
    """A shot that was opened: what renders it, its cameras, and the size of its pictures."""

    shot: Shot
    renderer: FieldRenderer
    cameras: Cameras
    size: tuple[int, int]

    @classmethod
    def of(cls, shot: Shot, options: PictureOptions) -> _Opened:
        """Open a shot."""
        scene, field, cameras = shot.open(options.changed_scene)
        layers, settings = options.layers(), options.render_settings()
        if "error" in layers and field.error is None:
            todo = "Fit it with `gpf fit`, or leave out error."
            raise UserError(str(shot.field_file), "has no error estimate", todo)
        if options.lights:
            set_lights(scene, field, options.lights)
        rendered = layers if "coverage" in layers else (*layers, "coverage")
        with telling_untraceable(str(shot.scene_file)):
            renderer = FieldRenderer.make(scene, field, settings, rendered)
        return cls(shot, renderer, cameras, options.film_size(cameras.aspect))

    def exposure(self, options: PictureOptions) -> float:
        """The exposure that is asked for, or that of the cameras or the field; without these, one
        for a small image of the first view."""
        known = self.renderer.integrator.field.record.get("exposure")
        if found := options.exposure or self.cameras.exposure or known:
            return float(found)
        size = max(1, round(64 * self.cameras.aspect)), 64
        with telling_untraceable(str(self.shot.scene_file)):
            layers = self.renderer.render(self.cameras.views[0], size, 0)
        return float(f"{propose_exposure(layers['radiance']):.3g}")

    def facts(self, options: PictureOptions) -> dict[str, Any]:
        """What the pictures depend on besides their exposure and views."""
        return {
            "method": "gpf",
            "field": hashlib.sha256(self.shot.field_file.read_bytes()).hexdigest()[:16],
            "fingerprint": fingerprint(self.renderer.scene),
            "size": list(self.size),
            "seconds": options.seconds,
            "seed": options.seed,
            "aovs": list(options.layers()),
            "lights": options.lights,
            "render": self.renderer.settings.model_dump(mode="json"),
        }


def _render(opened: _Opened, options: PictureOptions, views: list[View]) -> Iterator[Rendering]:
    """Render views one after the other, or on a Ray cluster."""
    renderer, size, shot = opened.renderer, opened.size, opened.shot
    streams = {view.name: stream_of(f"picture {view.name}") for view in views}
    seeds = {name: pass_seed(options.seed, 0, stream) for name, stream in streams.items()}
    if options.executor != "ray":
        for view in views:
            yield view, renderer.render(view, size, seeds[view.name], options.seconds)
        return
    from gpf.commands.cluster import RenderJob, pack_scene, render_on_cluster

    job = RenderJob(
        *pack_scene(shot.scene_file, shot.parameters),
        tuple(shot.parameters.items()),
        shot.field_file.read_bytes(),
        renderer.settings,
        renderer.aovs,
        size,
        options.seconds,
        options.lights,
    )
    yield from render_on_cluster(job, seeds, views, options.cluster)
