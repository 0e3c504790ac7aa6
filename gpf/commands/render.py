"""`gpf render`: pictures of any views of a scene, from a field."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gpf.commands.cameras import CameraChoice, Cameras
from gpf.commands.cluster import RenderJob, render_on_cluster
from gpf.commands.data_set import find_layers, has_layers, write_data_set, write_layers
from gpf.commands.overwriting import require_new
from gpf.commands.picture_options import PictureOptions
from gpf.commands.pictures import Pictures
from gpf.commands.shots import Shot, find_shots
from gpf.commands.workers import SentScenes
from gpf.core.cluster import ClusterChoice
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
from gpf.scene.frames import SceneFrame
from gpf.scene.untraceable import telling_untraceable
from gpf.scene.views import View


def render_pictures(
    scene_name: str,
    field_name: str | None,
    choice: CameraChoice,
    folder: Path | None,
    options: PictureOptions,
) -> None:
    """Render views as ``NAME.exr`` and ``NAME.png``, and write ``transforms.json``.

    Pictures that exist and were made in the same way are kept; others are replaced only with
    ``options.overwrite``.

    Parameters
    ----------
    scene_name, field_name: as for :func:`gpf.commands.shots.find_shots`.
    folder: by default ``pictures``, or that of the trained scene.

    Raises
    ------
    UserError: a file, a view or an option is wrong, or the field is for another scene.
    """
    options.check()
    shots, usual = find_shots(scene_name, field_name, choice)
    folder = folder or usual
    choose_variant("auto")
    first = _Opened.of(shots[0], options)
    size, total = first.size, len(shots) * len(first.cameras.views)
    start = time.perf_counter()
    with (
        sole_run(folder, inside=True),
        telling_untraceable(scene_name),
        progress_bar(f"{folder.name}: rendering", total) as bar,
    ):
        remove_leftovers(folder)
        work = _Work(folder, first.exposure(), options, bar)
        for picture, rendered in _render(work.missing(first, shots[1:]), options):
            work.write(picture, rendered)
        views, layers = work.views, options.layers()
        whole = Pictures(folder, tuple(views), layers, work.exposure, {})
        if options.film:
            whole.write_film()
        times = {shot.frame.name: shot.frame.time for shot in shots if shot.frame is not None}
        write_data_set(folder, views, size, layers, times)
    for remark in whole.remarks():
        say(f"{folder}: {remark}")
    made, kept = work.made, len(views) - work.made
    seconds = (time.perf_counter() - start) / max(made, 1)
    notes = [f"{made} picture{'s' if made != 1 else ''}, {seconds:.2f} s each"] if made else []
    notes += [f"{kept} already done"] if kept else []
    say(f"{folder}: {'; '.join(notes)}")


@dataclass(frozen=True)
class _Opened:
    """A shot that was opened: what renders it, its cameras, and the size of its pictures."""

    shot: Shot
    options: PictureOptions
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
        return cls(shot, options, renderer, cameras, options.film_size(cameras.aspect))

    def exposure(self) -> float:
        """The exposure that is asked for, or that of the cameras or the field; without these, one
        for a small image of the first view."""
        known = self.renderer.integrator.field.record.get("exposure")
        if found := self.options.exposure or self.cameras.exposure or known:
            return float(found)
        size = max(1, round(64 * self.cameras.aspect)), 64
        with telling_untraceable(str(self.shot.scene_file)):
            layers = self.renderer.render(self.cameras.views[0], size, 0)
        return float(f"{propose_exposure(layers['radiance']):.3g}")

    def facts(self) -> dict[str, Any]:
        """What the pictures depend on besides their exposure and views."""
        return {
            "method": "gpf",
            "field": hashlib.sha256(self.shot.field_file.read_bytes()).hexdigest()[:16],
            "fingerprint": fingerprint(self.renderer.scene),
            "size": list(self.size),
            "seconds": self.options.seconds,
            "seed": self.options.seed,
            "aovs": list(self.options.layers()),
            "lights": self.options.lights,
            "render": self.renderer.settings.model_dump(mode="json"),
        }

    @cached_property
    def job(self) -> RenderJob:
        """What a worker needs for the pictures."""
        scene = SceneFrame("", self.shot.scene_file, self.shot.parameters)
        return RenderJob(
            SentScenes.pack([scene]),
            self.shot.field_file.read_bytes(),
            self.renderer.settings,
            self.renderer.aovs,
            self.size,
            self.options.seconds,
            self.options.lights,
        )


@dataclass(frozen=True)
class _Picture:
    """A picture to be made, and what its data set has of its surfaces (:func:`find_layers`)."""

    pictures: Pictures
    view: View
    seed: int
    centres: Mapping[str, np.ndarray]

    def __str__(self) -> str:
        return f"view {self.view.name}"


class _Work:
    """What is to be rendered, and what is done.

    Attributes
    ----------
    views: those of all shots that were opened.
    made: the number of pictures that were rendered.
    """

    def __init__(self, folder: Path, exposure: float, options: PictureOptions, bar: Bar) -> None:
        self.folder, self.exposure, self.options = folder, exposure, options
        self.views: list[View] = []
        self.made = self._done = 0
        self._bar = bar

    def missing(self, first: _Opened, shots: Sequence[Shot]) -> Iterator[tuple[_Opened, _Picture]]:
        """The pictures that are missing or out of date. Shots are opened one after the other."""
        yield from self._missing(first)
        for shot in shots:
            yield from self._missing(_Opened.of(shot, self.options))

    def _missing(self, opened: _Opened) -> Iterator[tuple[_Opened, _Picture]]:
        layers, views = self.options.layers(), opened.cameras.views
        pictures = Pictures(self.folder, views, layers, self.exposure, opened.facts())
        for view in views:
            if pictures.is_another(view):
                require_new(pictures.exr(view), self.options.overwrite, "give another folder")
        self.views += views
        for view in views:
            is_done = pictures.is_current(view)
            self._count(is_done)
            if is_done and has_layers(self.folder, view, layers):
                continue
            centres = find_layers(opened.renderer.scene, view, opened.size, layers)
            if is_done:
                write_layers(self.folder, view, centres)
                continue
            seed = pass_seed(self.options.seed, 0, stream_of(f"picture {view.name}"))
            yield opened, _Picture(pictures, view, seed, centres)

    def write(self, picture: _Picture, layers: dict[str, np.ndarray]) -> None:
        """Write a picture."""
        picture.pictures.write(picture.view, layers, picture.centres)
        self.made += 1
        self._count(1)

    def _count(self, done: int) -> None:
        self._done += done
        self._bar(self._done)


def _render(
    missing: Iterable[tuple[_Opened, _Picture]], options: PictureOptions
) -> Iterator[tuple[_Picture, dict[str, np.ndarray]]]:
    """Render pictures one after the other, or on a Ray cluster."""
    cluster = ClusterChoice.of_options(options.executor, options.cluster)
    if cluster is not None:
        jobs = ((picture, opened.job, picture.view, picture.seed) for opened, picture in missing)
        yield from render_on_cluster(cluster, jobs)
        return
    for opened, picture in missing:
        size, renderer = opened.size, opened.renderer
        yield picture, renderer.render(picture.view, size, picture.seed, options.seconds)
