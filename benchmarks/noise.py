"""What each remedy against the noise of camera samples does, alone and with the others."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import product
from typing import Annotated
from unittest.mock import patch

import drjit as dr
import mitsuba as mi
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from benchmarks import cli
from benchmarks.measured_scenes import MeasuredScene, open_scene
from benchmarks.truth import Truth, decibels
from gpf.field.field import GaussianPhotonField
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.views import View

MECHANISMS = ("adaptive", "grouped", "fireflies", "denoiser")


def noise(
    scenes: cli.Scenes = None,
    seconds: cli.Seconds = 20,
    rows: cli.Rows = 192,
    spp: Annotated[list[int] | None, typer.Option(min=16, help="May be repeated.")] = None,
    samples: cli.Samples = 1024,
) -> None:
    """Noise of a view and its time, for each combination of adaptive samples, grouped walks,
    suppressed fireflies and the denoiser.

    The view is compared with two images of the same field with many samples, none of the four in
    them, so that only the noise and what the four do to the image count: PSNR, energy, and the
    greatest relative error of a pixel in a thousand. Seconds are the least of three.
    """
    for name in scenes or ["cornell_box", "veach_ajar"]:
        measured = open_scene(name)
        view = measured.judged_views[0] if measured.views else measured.own
        field = measured.fit([view], rows, seconds=seconds)
        render = partial(_render, measured, field, view, rows)
        many = RenderSettings(spp=samples, adaptive=False, suppress_fireflies=False)
        halves = np.stack([render(many, seed) for seed in range(2)], axis=1)
        truth = Truth(halves, measured.exposure)
        for number in spp or [16, 64]:
            table = Table(*MECHANISMS, "PSNR", "energy", "1 in 1000", "s")
            table.title = f"{measured.name}, {number} samples per pixel"
            for chosen in product((False, True), repeat=len(MECHANISMS)):
                with switched(*chosen, spp=number) as settings:
                    images, spent = _timed(partial(render, settings, 2))
                marks = ("x" if used else "" for used in chosen)
                table.add_row(*marks, *judge(truth, images), f"{spent:.2f}")
            Console(width=100).print(table)


def _render(
    measured: MeasuredScene,
    field: GaussianPhotonField,
    view: View,
    rows: int,
    settings: RenderSettings,
    seed: int,
) -> np.ndarray:
    """An image, (1, H, W, 3)."""
    renderer = FieldRenderer.make(measured.scene, field, settings)
    return renderer.render(view, measured.size(rows), seed)["radiance"][None]


@contextmanager
def switched(
    adaptive: bool, grouped: bool, fireflies: bool, denoiser: bool, spp: int
) -> Iterator[RenderSettings]:
    """Settings with some of the mechanisms; samples come in sets in any case."""

    def equal(noise: mi.Float64, mean: int, least: mi.UInt32) -> mi.UInt32:
        return dr.full(mi.UInt32, mean, dr.width(noise))

    with ExitStack() as stack:
        if not adaptive:
            stack.enter_context(patch("gpf.rendering.adaptive.allocate", equal))
        if not grouped:
            stack.enter_context(patch("gpf.rendering.gpf.GroupedWalks", lambda walks, *_: walks))
        yield RenderSettings(spp=spp, suppress_fireflies=fireflies, denoise=denoiser)


def judge(truth: Truth, images: np.ndarray) -> list[str]:
    """The cells of a line."""
    true = truth.halves.mean(axis=1)
    relative = np.abs(images - true).mean(axis=3) / (true.mean(axis=3) + 0.01 * np.median(true))
    return [
        decibels(truth.errors(images).mean()),
        f"{images.sum() / true.sum():.4f}",
        f"{np.quantile(relative, 0.999):.2f}",
    ]


def _timed(render: Callable[[], np.ndarray]) -> tuple[np.ndarray, float]:
    """An image, and the seconds that it takes."""
    spent = []
    for _ in range(3):
        start = time.perf_counter()
        images = render()
        spent.append(time.perf_counter() - start)
    return images, min(spent)
