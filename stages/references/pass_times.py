"""The mean time of an SPPM pass over a long run."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from stages.references.groups import Job
from stages.references.renderer import ReferenceRenderer

SAMPLES, ONE_IN = 8, 16
"""Timed passes of each kind: one in 16 of all passes, but at most 8."""


def time_kinds_of_passes(job: Job, passes: int) -> dict[str, float]:
    """Mean seconds per pass over ``passes`` passes: for a single view, shared views, targets.

    The stage's own passes serve images and targets at once, so each kind is timed separately.
    Single: mean over the novel views, each rendered on its own. Shared: all novel views at once,
    divided by their number.
    """
    section, source = job.work.params.reference, job.plan.source
    job.costs.parts.pop("probe", None)
    points = job.target_points(job.work.views.train, section.surface_points)
    singles = single_views(job)
    sensors = {name: s for renderer in singles for name, s in renderer.sensors.items()}
    shared = ReferenceRenderer(job.scene, sensors, {}, job.settings, section.seed, source)
    targets = ReferenceRenderer(job.scene, {}, points, job.settings, section.seed, source)
    every = [*singles, shared, targets]
    with job.costs.measure("probe"):
        compile_passes((singles[0], shared, targets))  # all single views have the same kernels
        samples = min(SAMPLES, -(-passes // ONE_IN))
        seconds = time_passes(every, range(1, passes + 1), samples)
    return {
        "seconds_per_single_view_pass": float(seconds[:-2].mean()),
        "seconds_per_shared_view_pass": float(seconds[-2] / len(singles)),
        "seconds_per_target_pass": float(seconds[-1]),
    }


def single_views(job: Job) -> list[ReferenceRenderer]:
    """A renderer for each novel view on its own; without novel views, for the first training
    view."""
    work, source, seed = job.work, job.plan.source, job.work.params.reference.seed
    return [
        ReferenceRenderer(job.scene, {v.name: work.sensor(v)}, {}, job.settings, seed, source)
        for v in work.views.novel or work.views.train[:1]
    ]


def compile_passes(renderers: Sequence[ReferenceRenderer]) -> None:
    """Run passes so that all kernels are compiled before any is timed."""
    for renderer in renderers:
        for _ in range(2):
            renderer.run_pass(1, renderer.empty_sums())


def time_passes(renderers: Sequence[ReferenceRenderer], passes: range, samples: int) -> np.ndarray:
    """Mean seconds of a pass over a range of passes, for each of the R renderers, (R,).

    The time of a pass falls with the radius, as t^-0.3. The timed passes are therefore the middles
    of equal parts of the range; with both ends included, the mean over 1000 passes would be a
    quarter too large. The renderers take turns, so that other load affects all of them.
    """
    seconds = np.empty((samples, len(renderers)))
    sums = [renderer.empty_sums() for renderer in renderers]
    for i in range(samples):
        t = passes[int(len(passes) * (i + 0.5) / samples)]
        for j, renderer in enumerate(renderers):
            start = time.perf_counter()
            renderer.run_pass(t, sums[j])
            seconds[i, j] = time.perf_counter() - start
    return seconds.mean(axis=0)
