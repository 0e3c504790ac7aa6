"""The light of an animation's frames, by fields and by others in the same time."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import tee
from pathlib import Path
from typing import Annotated, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

import gpf
from baselines.luxcore.baseline import Luxcore
from baselines.options import LuxcoreOptions
from baselines.protocol import CannotServe, Task
from benchmarks import cli
from benchmarks.judged import KERNELS
from benchmarks.moving_scenes import Animation, open_animation
from benchmarks.truth import Truth, decibels, keep, radiance_pairs, sppm, sppm_images
from gpf.core.errors import UserError
from gpf.core.progress import progress_bar, say
from gpf.field.field import GaussianPhotonField
from gpf.fitting.frames import LEAST_PASSES, SECONDS
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.folders import load_views
from gpf.scene.frames import SceneFrame, choose_frames, scene_frames
from gpf.scene.load import load_frame
from gpf.scene.sensors import make_sensor
from gpf.scene.views import SceneViews

EQUAL_TIME_SEED = 100
"""Of the pictures that are compared with the truth, whose seeds are 0 and 1."""

ONE_AFTER_THE_OTHER = "fields, one after the other"


@dataclass(frozen=True)
class Picture:
    """A frame's image, (H, W, 3), and the seconds that its light took; for a field also the number
    of Gaussians, and the seconds of the image."""

    image: np.ndarray
    seconds: float
    gaussians: int = 0
    view_seconds: float = 0.0


def frames(
    animation: Annotated[str, typer.Argument(help="waves, door, lamp or ball.")],
    wanted: Annotated[
        str, typer.Option("--frames", metavar="all|FIRST:LAST", help="The frames.")
    ] = "0:8",
    seconds: cli.Seconds = SECONDS,
    passes: Annotated[
        int | None,
        typer.Option(
            min=LEAST_PASSES,
            help="Passes of each frame, in place of a time: fields one after the other against a "
            "first field in each frame, to see what long animations lose.",
        ),
    ] = None,
    alone: Annotated[
        list[float] | None,
        typer.Option(help="Seconds of a fit of each frame alone; may be repeated."),
    ] = None,
    rows: cli.Rows = 256,
    reference_passes: cli.ReferencePasses = 300,
    kept: cli.Kept = cli.KEPT,
) -> None:
    """Fields of frames that begin with the field before, against fits of each frame alone, and
    against SPPM and LuxCore's caches in the time of a field. With --passes, against a first field
    in each frame alone.

    A line has the median seconds of a frame, and of a view from its field; the number of Gaussians
    of the first and of the last frame; the PSNR of a view, mean, least and in the last frame; and
    its flicker, the root mean square of the error of the differences between frames. The truth is
    SPPM, without its noise.
    """
    if passes is not None and alone:
        raise UserError("--passes and --alone", "are mutually exclusive", "Leave one of them out.")
    moves = open_animation(animation)
    with tempfile.TemporaryDirectory() as name:
        folder = moves.write(Path(name))
        every = scene_frames(folder)
        film = Film(moves, every[choose_frames(wanted, len(every), animation)], rows)
        file = kept / f"{animation}_{wanted.replace(':', '_')}_{rows}_{reference_passes}.npz"
        truth = Truth(keep(file, lambda: film.truth(reference_passes))["images"], film.exposure)
        columns = "s", "s, view", "Gaussians", "PSNR", "least", "last", "flicker"
        table = Table("", *columns, title=animation)
        methods = (
            film.methods(seconds, alone or [seconds]) if passes is None else film.drift(passes)
        )
        for title, pictures in methods.items():
            table.add_row(title, *film.judge(title, pictures, truth))
        Console(width=120).print(table)


@dataclass(frozen=True)
class Film:
    """Frames of an animation, of which one view is judged."""

    animation: Animation
    frames: Sequence[SceneFrame]
    rows: int

    @cached_property
    def views(self) -> SceneViews:
        """Those of the scene."""
        return load_views(self.animation.scene)

    @property
    def exposure(self) -> float:
        """That of the scene."""
        return self.views.exposure

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        return self.views.size(self.rows)

    def sensor(self) -> mi.Sensor:
        """Of the judged view."""
        return make_sensor(self.views.find(self.animation.view), *self.size)

    def scenes(self) -> Iterator[mi.Scene]:
        """The scenes of all frames."""
        for frame in self.frames:
            yield load_frame(frame)
            dr.flush_malloc_cache()

    def truth(self, passes: int) -> dict[str, np.ndarray]:
        """Two images of each frame."""
        found = []
        for frame, scene in zip(self.frames, self.scenes(), strict=True):
            images = sppm_images(frame.name, scene, [self.sensor()], passes, KERNELS["long"])
            found.append(radiance_pairs(images)[0])
        return {"images": np.array(found)}

    def methods(self, seconds: float, alone: Sequence[float]) -> dict[str, Iterator[Picture]]:
        """What is compared, by title."""
        found = {ONE_AFTER_THE_OTHER: self._fields(seconds=seconds)}
        for each in alone:
            found[f"a fit of each alone, {each:g} s"] = self._fits(each)
        found["SPPM, other photons in each frame"] = self._sppm(seconds, lambda number: number)
        found["SPPM, the same photons"] = self._sppm(seconds, lambda number: 0)
        found["LuxCore, caches"] = self._luxcore(seconds)
        return found

    def drift(self, passes: int) -> dict[str, Iterator[Picture]]:
        """Fields of an animation, and a first field in each of its frames, by title."""
        return {
            ONE_AFTER_THE_OTHER: self._fields(passes=passes),
            "a first field in each frame": self._first_fields(passes),
        }

    def judge(self, title: str, pictures: Iterator[Picture], truth: Truth) -> list[str]:
        """The cells of a line."""
        with progress_bar(title, len(self.frames)) as bar:
            try:
                made = []
                for picture in pictures:
                    made.append(picture)
                    bar(len(made))
            except CannotServe as error:
                say(str(error))
                return ["", "", "", error.told]
        images = np.array([picture.image for picture in made])
        errors = truth.errors(images).mean(axis=1)
        seconds, view = (np.median([(p.seconds, p.view_seconds) for p in made], axis=0)).tolist()
        first, last = made[0].gaussians, made[-1].gaussians
        return [
            f"{seconds:.1f}",
            f"{view:.1f}" if view else "",
            f"{first:,} to {last:,}" if first else "",
            decibels(errors.mean()),
            decibels(errors.max()),
            decibels(errors[-1]),
            f"{flicker(images, truth):.4f}",
        ]

    def _fields(self, **goal: Any) -> Iterator[Picture]:
        fitted, shown = tee(self.scenes())
        fields = gpf.fit_frames(fitted, self._training(), **goal)
        for scene, field in zip(shown, fields, strict=True):
            yield self._render(scene, field)

    def _first_fields(self, passes: int) -> Iterator[Picture]:
        for scene in self.scenes():
            (field,) = gpf.fit_frames([scene], self._training(), passes=passes)
            yield self._render(scene, field)

    def _fits(self, seconds: float) -> Iterator[Picture]:
        for scene in self.scenes():
            yield self._render(scene, gpf.fit(scene, self._training(), seconds=seconds))

    def _training(self) -> list[mi.Sensor]:
        return [make_sensor(view, *self.size) for view in self.views.train]

    def _render(self, scene: mi.Scene, field: GaussianPhotonField) -> Picture:
        start = time.perf_counter()
        view = self.views.find(self.animation.view)
        renderer = FieldRenderer.make(scene, field, RenderSettings())
        image = renderer.render(view, self.size, seed=0)["radiance"]
        spent = time.perf_counter() - start
        count = dr.width(field.gaussians.means)
        return Picture(image, float(field.record["seconds"]), count, spent)

    def _sppm(self, seconds: float, seed: Callable[[int], int]) -> Iterator[Picture]:
        for number, scene in enumerate(self.scenes()):
            start = time.perf_counter()
            renderer = sppm(scene, [self.sensor()], EQUAL_TIME_SEED + seed(number))
            sums, passes = renderer.empty_sums(), 0
            while passes == 0 or time.perf_counter() - start < seconds:
                passes += 1
                renderer.run_pass(passes, sums)
                dr.sync_thread()
            spent = time.perf_counter() - start
            yield Picture(renderer.view("0", sums).layers()["radiance"], spent)

    def _luxcore(self, seconds: float) -> Iterator[Picture]:
        view = self.views.find(self.animation.view)
        for number, scene in enumerate(self.scenes()):
            file, shown = self.frames[number].file, (self.size, self.exposure)
            with tempfile.TemporaryDirectory() as state:
                task = Task(self.animation.scene, scene, file, *shown, (), 5, 0, Path(state))
                options = LuxcoreOptions(system="luxcore", seconds=seconds)
                prepared = Luxcore(options).prepare(task)
                start = time.perf_counter()
                image = prepared.render(view, number)
                yield Picture(image, time.perf_counter() - start)


def flicker(images: np.ndarray, truth: Truth) -> float:
    """The root mean square of the error of the differences between frames (V, H, W, 3)."""
    change, *true = (
        np.diff(truth.shown(each), axis=0)
        for each in (images, truth.halves[:, 0], truth.halves[:, 1])
    )
    first, second = (change - each for each in true)
    return float(np.sqrt(max((first * second).mean(), 0)))
