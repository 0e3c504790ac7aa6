"""What a pass of SPPM takes, for measurements that time it in turns with something else."""

from __future__ import annotations

import time

import numpy as np

from gpf.reference import ReferenceRenderer
from stages.groups import Job
from stages.workspace import Workspace


class SinglePasses:
    """SPPM for one view, a pass at a time."""

    def __init__(self, work: Workspace) -> None:
        job = Job.open(work)
        view = work.views.novel[0]
        self.passes = work.params.reference.passes
        sensors = {view.name: work.sensor(view)}
        seed, source = work.params.reference.seed, job.lookout.source
        self.renderer = ReferenceRenderer(job.scene, sensors, {}, job.settings, seed, source)
        for _ in range(2):  # compile
            self.renderer.run_pass(1)

    def seconds(self, parts: int, k: int, samples: int = 8) -> float:
        """Mean over passes of the ``k``-th of so many parts: they get cheaper as radii shrink."""
        first, last = 1 + self.passes * k // parts, self.passes * (k + 1) // parts
        numbers = np.linspace(first, max(first, last), samples).astype(int)
        start = time.perf_counter()
        for t in numbers:
            self.renderer.run_pass(int(t))
        return (time.perf_counter() - start) / samples
