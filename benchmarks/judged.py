"""SPPM images of a scene's views, with which fields are compared.

The truth has kernels half as wide as those of the last pass of an ordinary reference. Ordinary
references have wider ones, in all of their passes, and show caustics softer than they are. Two of
them, a and b, are compared with the truth too: their error is the mean of (a - A) (b - B), plus
their noise, from a - b.

With the truth `long`, A and B have the kernels of references with 4000 passes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import mitsuba as mi
import numpy as np

from benchmarks.measured_scenes import MeasuredScene
from benchmarks.regions import find_regions
from benchmarks.truth import Truth, decibels, keep, radiance_pairs, sppm_images
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field, save_field
from gpf.scene.views import View

STANDARD = 1000
"""Passes of an ordinary reference."""

KERNELS = {"standard": (1, 1000), "sharp": (64_000, 65_000), "long": (1, 4000)}
"""First and last of the passes whose kernels each kind of image has."""

FIT_ROWS = 256
"""Rows of the views to which fields are fitted."""


@dataclass(frozen=True)
class Judged:
    """The judged views of a scene.

    Attributes
    ----------
    references: two ordinary references of each view.
    regions: the number of each pixel's region, (V, H W).
    passes: passes of each image.
    """

    views: Sequence[View]
    references: Truth
    truth: Truth
    regions: np.ndarray
    passes: int

    def reference_errors(self, passes: int = STANDARD) -> np.ndarray:
        """Squared error of an ordinary reference with ``passes`` passes, its noise included, at
        each pixel, (V, H W)."""
        a, b = self.references.halves[:, 0], self.references.halves[:, 1]
        return self.truth.errors(a, b) + self.noise(passes)

    def differences(self, images: np.ndarray) -> np.ndarray:
        """Squared difference of images (V, H, W, 3) from an ordinary reference, its noise included,
        (V, H W)."""
        return self.references.errors(images) + self.noise(STANDARD)

    def noise(self, passes: int) -> np.ndarray:
        """Squared noise of an ordinary reference with ``passes`` passes, (V, H W)."""
        a, b = (self.references.shown(self.references.halves[:, half]) for half in range(2))
        noise: np.ndarray = ((a - b) ** 2).mean(axis=3) / 2 * self.passes / passes
        return noise.reshape(self.regions.shape)


def judge_views(
    measured: MeasuredScene,
    rows: int,
    passes: int,
    kept: Path,
    kernels: str = "sharp",
    count: int | None = None,
) -> Judged:
    """The first ``count`` of a scene's judged views."""
    views = measured.judged_views[:count]
    sensors = measured.sensors(views, rows)
    found = {}
    for kind in ("standard", kernels):
        file = kept / f"{measured.name}_{kind}_{rows}_{len(views)}_{passes}.npz"
        found[kind] = keep(file, partial(_trace, measured, sensors, passes, KERNELS[kind]))
    return Judged(
        views,
        Truth(found["standard"]["images"], measured.exposure),
        Truth(found[kernels]["images"], measured.exposure),
        found["standard"]["regions"],
        passes,
    )


def _trace(
    measured: MeasuredScene, sensors: list[mi.Sensor], passes: int, kernels: tuple[int, int]
) -> dict[str, np.ndarray]:
    halves = list(sppm_images(measured.name, measured.scene, sensors, passes, kernels))
    images = radiance_pairs(halves)
    regions = [
        find_regions(measured.scene, sensor, layers | {"radiance": both.mean(axis=0)})
        for sensor, layers, both in zip(sensors, halves[0], images, strict=True)
    ]
    return {"images": images, "regions": np.stack(regions)}


def kept_field(measured: MeasuredScene, seconds: float, kept: Path) -> GaussianPhotonField:
    """A field fitted for ``seconds`` with the scene's training views, or the one in the folder."""
    file = kept / f"{measured.name}_{seconds:g}s.safetensors"
    if not file.exists():
        save_field(measured.fit(measured.training_views, FIT_ROWS, seconds=seconds), file)
    return load_field(file)


def mean_psnr(errors: np.ndarray) -> str:
    """The mean of the views' PSNR, as text, from squared errors (V, H W)."""
    each = errors.mean(axis=1)
    return decibels(10 ** np.log10(each).mean()) if each.min() > 0 else "-"
