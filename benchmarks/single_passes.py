"""What a pass of SPPM takes, for measurements that time it in turns with something else."""

from __future__ import annotations

from gpf.reference import ReferenceRenderer
from stages.groups import Job
from stages.pass_times import compile_passes, time_passes
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
        compile_passes([self.renderer])

    def seconds(self, parts: int, k: int, samples: int = 8) -> float:
        """Mean over passes of the ``k``-th of so many parts."""
        passes = range(1 + self.passes * k // parts, 1 + self.passes * (k + 1) // parts)
        return float(time_passes([self.renderer], passes, samples)[0])
