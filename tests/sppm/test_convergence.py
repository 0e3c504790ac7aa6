"""How fast SPPM's error falls: variance as T^-α, squared bias as T^-2(1-α).

Knaus and Zwicker (2011): radii with r² ~ t^(α-1) give a mean over T passes with these rates; at
α = 2/3 they are the same, and the error as a whole falls as T^(-2/3).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import VisiblePoints, from_numpy
from gpf.sppm.passes import PassSettings
from stages.references.renderer import ReferenceRenderer
from tests.furnace import diffuse, floor, point_light

HEIGHT, INTENSITY = 0.35, 2.0


@dataclass(frozen=True)
class Run:
    """``tolerance`` is of the slopes: some three standard errors."""

    counts: tuple[int, ...]
    seeds: int
    photons: int
    tolerance: float


QUICK = Run((1, 3, 10, 30), seeds=6, photons=64_000, tolerance=0.15)
PRECISE = Run((1, 3, 10, 30, 100, 300, 1000), seeds=4, photons=4000, tolerance=0.06)


def grid_points() -> tuple[VisiblePoints, np.ndarray]:
    """Points of the plane z = 0 below a lamp, and the irradiance there: I cos θ / d²."""
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-0.6, 0.6, 24), np.linspace(-0.5, 0.7, 20)))
    points = dr.zeros(VisiblePoints, len(x))
    points.p = from_numpy(mi.Point3f, np.stack([x, y, 0 * x], axis=1))
    points.n = mi.Normal3f(0, 0, 1)
    points.valid = dr.full(mi.Bool, True, len(x))
    dr.make_opaque(points)
    distance2 = x**2 + y**2 + HEIGHT**2
    return points, INTENSITY * HEIGHT / distance2**1.5


@pytest.mark.parametrize(
    ("alpha", "run"),
    [
        pytest.param(2 / 3, QUICK, id="2/3, quick"),
        pytest.param(2 / 3, PRECISE, id="2/3, precise", marks=pytest.mark.long),
        pytest.param(0.8, PRECISE, id="0.8, precise", marks=pytest.mark.slow),
    ],
)
def test_the_error_falls_as_theory_has_it(alpha, run):
    scene = mi.load_dict(
        {
            "type": "scene",
            "floor": floor(diffuse(0.5)),
            "light": point_light((0, 0, HEIGHT), INTENSITY),
        }
    )
    points, expected = grid_points()
    counts = np.array(run.counts)
    settings = PassSettings(
        photons_per_pass=run.photons, initial_radius=0.15, alpha=alpha, direct="photons"
    )
    runs = []
    for seed in range(run.seeds):
        renderer = ReferenceRenderer(scene, {}, {"floor": points}, settings, seed)
        images, sums = [], None
        for count in counts:
            sums = renderer.run(int(count), sums)
            images.append(renderer.mean_irradiance("floor", sums)[:, 0])
        runs.append(images)
    error = np.array(runs) / expected - 1  # (seeds, counts, points)

    variance = error.var(0, ddof=1).mean(1)
    # What different seeds have in common is the bias: products of independent errors.
    bias2 = ((error.sum(0) ** 2 - (error**2).sum(0)) / (run.seeds * (run.seeds - 1))).mean(1)
    r2 = np.cumprod([1.0, *((t + alpha) / (t + 1) for t in range(1, counts[-1]))])
    predicted_variance = (np.cumsum(1 / r2) / np.arange(1, len(r2) + 1) ** 2)[counts - 1]
    predicted_bias2 = ((np.cumsum(r2) / np.arange(1, len(r2) + 1)) ** 2)[counts - 1]

    print(f"\nα = {alpha:.2f}: error {slope(counts, variance + bias2):.3f}", end="")
    for name, found, expected, last in (
        ("variance", slope(counts, variance), slope(counts, predicted_variance), -alpha),
        ("squared bias", slope(counts, bias2), slope(counts, predicted_bias2), -2 * (1 - alpha)),
    ):
        print(f", {name} {found:.3f} (expected {expected:.3f}, in the end {last:.3f})", end="")
        assert found == pytest.approx(expected, abs=run.tolerance)


def slope(counts: np.ndarray, values: np.ndarray) -> float:
    """The exponent of a power of the number of passes."""
    return float(np.polyfit(np.log(counts), np.log(values), 1)[0])
