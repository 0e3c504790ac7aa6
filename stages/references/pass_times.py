"""What a pass of SPPM takes, on average over a long run of them."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from gpf.sppm.reference import ReferenceRenderer
from stages.references.groups import Job

SAMPLES, ONE_IN = 8, 16
"""Timed passes of each kind: at most so many, and one in so many of all passes."""


def time_kinds_of_passes(job: Job, passes: int) -> dict[str, float]:
    """What one of so many passes costs: for one view, for views that share photons, for targets.

    The stage's own passes serve images and targets at once. Single views: mean over the novel
    views, each on its own; shared: all of them at once, divided by their number.
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
        compile_passes(every)
        samples = min(SAMPLES, -(-passes // ONE_IN))
        seconds = time_passes(every, range(1, passes + 1), samples)
    return {
        "seconds_per_single_view_pass": float(seconds[:-2].mean()),
        "seconds_per_shared_view_pass": float(seconds[-2] / len(singles)),
        "seconds_per_target_pass": float(seconds[-1]),
    }


def single_views(job: Job) -> list[ReferenceRenderer]:
    """SPPM for each of the novel views on its own; without any, for the first training view."""
    work, source, seed = job.work, job.plan.source, job.work.params.reference.seed
    return [
        ReferenceRenderer(job.scene, {v.name: work.sensor(v)}, {}, job.settings, seed, source)
        for v in work.views.novel or work.views.train[:1]
    ]


def compile_passes(renderers: Sequence[ReferenceRenderer]) -> None:
    """Run what a first pass needs and a later one finds made."""
    for renderer in renderers:
        for _ in range(2):
            renderer.run_pass(1, renderer.empty_sums())


def time_passes(renderers: Sequence[ReferenceRenderer], passes: range, samples: int) -> np.ndarray:
    """Seconds that a pass takes, mean over a range of passes, (R,).

    Passes get cheaper as radii shrink, as t^-0.3, so samples are the middles of equal parts: the
    mean with both ends is a quarter too large for 1000 passes. The renderers take turns, so that
    other load on the machine meets all of them.
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
