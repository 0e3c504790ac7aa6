"""Images that the benchmarks take as the truth, by SPPM or by path tracing.

The truth is what two independent images A and B of a view have in common. The mean of
(f - A) (f - B) is the squared error of an image f without the noise of A and B. Images and fields
are kept in a folder for the next run.

Displayed values s(A) of a noisy image are too dark: a display saturates, and its curve is concave.
With n samples, the error is about c/n. So where the parts of A with n/2 samples each are known,
2 s(A) - ⟨s(parts)⟩ takes the place of s(A). In a room with caustics, 1,024 samples per pixel would
otherwise make a field 2 dB worse than it is, and whoever removes fireflies better.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np

from gpf.core.images import tone_map
from gpf.core.progress import progress_bar
from gpf.guiding.emission_plan import EmissionPlan, VisibleRegionSettings
from gpf.sppm.reference import ReferenceSettings
from metrics.flip import evaluate_ldr
from stages.references.renderer import ReferenceRenderer

TRIMMED = 0.005
"""Fraction of the pixels, the brightest, that do not count in :meth:`Truth.energy`."""


@dataclass(frozen=True)
class Truth:
    """Two independent images of each view, and their exposure.

    Attributes
    ----------
    halves: the images, (V, 2, H, W, 3).
    parts: two independent images whose mean each of them is, (V, 2, 2, H, W, 3), if they are known.
    """

    halves: np.ndarray
    exposure: float
    parts: np.ndarray | None = None

    @classmethod
    def of_parts(cls, parts: np.ndarray, exposure: float) -> Truth:
        """The truth whose halves have parts, (V, 2, 2, H, W, 3)."""
        return cls(parts.mean(axis=2), exposure, parts)

    def errors(self, images: np.ndarray, again: np.ndarray | None = None) -> np.ndarray:
        """Squared error of images (V, H, W, 3) at each pixel, (V, H W).

        ``again``: the same images with other samples, so that their noise does not count.
        """
        f, g = self.shown(images), self.shown(images if again is None else again)
        a, b = (self._shown_half(half) for half in range(2))
        return ((f - a) * (g - b)).mean(axis=3).reshape(len(f), -1)

    def energy(self, images: np.ndarray, chosen: np.ndarray | bool = True) -> float:
        """Sum of images (V, H, W, 3) divided by that of the truth, over chosen pixels, (V, H, W),
        without the brightest of either."""
        true = self.halves.mean(axis=1)
        kept = np.full(true.shape[:3], chosen)
        for each in (images, true):
            light = each.mean(axis=3)
            kept &= light <= np.quantile(light, 1 - TRIMMED)
        return float(images[kept].sum() / true[kept].sum())

    def flip(self, images: np.ndarray) -> float:
        """Mean LDR-FLIP of images (V, H, W, 3)."""
        shown, true = (
            self.shown(each).astype(np.float64) for each in (images, self.halves.mean(axis=1))
        )
        return float(np.mean([evaluate_ldr(*pair) for pair in zip(shown, true, strict=True)]))

    def _shown_half(self, half: int) -> np.ndarray:
        """Displayed values of a half, (V, H, W, 3), as they would be without noise."""
        shown = self.shown(self.halves[:, half])
        if self.parts is None:
            return shown
        return 2 * shown - self.shown(self.parts[:, half]).mean(axis=1)

    def shown(self, images: np.ndarray) -> np.ndarray:
        """Displayed values."""
        return tone_map(images, self.exposure)


def decibels(error: float) -> str:
    """The PSNR for a mean squared error, as text."""
    return f"{-10 * np.log10(error):.1f}" if error > 0 else "-"


def keep(file: Path, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays from a file, which is made if it is not there."""
    if not file.exists():
        made = make()
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(file, **made)  # type: ignore[arg-type]
    with np.load(file) as stored:
        return dict(stored)


def trace_paths(
    what: str, scene: mi.Scene, sensor: mi.Sensor, samples: int, seed: int = 0, at_once: int = 128
) -> np.ndarray:
    """The radiance by `path`, (H, W, 3)."""
    integrator = mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": 8})
    rounds = -(-samples // at_once)
    total: np.ndarray | float = 0.0
    with progress_bar(f"{what}: path", rounds) as bar:
        for k in range(rounds):
            own = seed * rounds + k
            image = mi.render(scene, sensor=sensor, integrator=integrator, spp=at_once, seed=own)
            total = total + np.array(image, dtype=np.float64)[..., :3]
            bar(k + 1)
    return np.asarray(total / rounds, np.float32)


def path_parts(
    what: str, scene: mi.Scene, sensors: Sequence[mi.Sensor], samples: int
) -> np.ndarray:
    """Two images of each view by `path`, as the parts of :class:`Truth` with half as many samples
    each, (V, 2, 2, H, W, 3)."""
    count = -(-samples // 2)
    at_once = min(count, 128 if len(sensors) == 1 else 32)
    found = np.array(
        [
            [trace_paths(what, scene, sensor, count, seed, at_once) for seed in range(4)]
            for sensor in sensors
        ]
    )
    return in_parts(found)


def in_parts(images: np.ndarray) -> np.ndarray:
    """Four independent images of each view, (V, 4, H, W, 3), as the parts of two halves."""
    return images.reshape(len(images), 2, 2, *images.shape[2:])


def sppm(scene: mi.Scene, sensors: Sequence[mi.Sensor], seed: int = 0) -> ReferenceRenderer:
    """Passes of SPPM for views named "0", "1", …, with the settings of references."""
    plan = EmissionPlan.make(scene, sensors, VisibleRegionSettings())
    settings = ReferenceSettings().measure(scene, sensors, plan)
    named = {f"{k}": sensor for k, sensor in enumerate(sensors)}
    return ReferenceRenderer(scene, named, {}, settings, seed, plan.source)


def sppm_images(
    what: str,
    scene: mi.Scene,
    sensors: Sequence[mi.Sensor],
    passes: int,
    kernels: tuple[int, int] | None = None,
    seeds: Sequence[int] = (0, 1),
) -> Iterator[list[dict[str, np.ndarray]]]:
    """For each seed, the layers of all views.

    Parameters
    ----------
    kernels: the passes have the kernels of those between these two, spread evenly; by default,
        their own.
    """
    first, last = kernels or (1, passes)
    for seed in seeds:
        renderer = sppm(scene, sensors, seed)
        sums = renderer.empty_sums()
        with progress_bar(f"{what}: SPPM {seed}", passes) as bar:
            for k in range(passes):
                renderer.run_pass(first + k * (last + 1 - first) // passes, sums)
                bar(k + 1)
        yield [renderer.view(name, sums).layers() for name in renderer.sensors]


def radiance_pairs(halves: Iterable[list[dict[str, np.ndarray]]]) -> np.ndarray:
    """The images of each view, (V, S, H, W, 3), from the layers of all views for S seeds."""
    views = zip(*halves, strict=True)
    return np.array([[layers["radiance"] for layers in each] for each in views])
