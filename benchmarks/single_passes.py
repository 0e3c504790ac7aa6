"""The time of an SPPM pass, for measurements that alternate it with something else."""

from __future__ import annotations

from stages.common.workspace import Workspace
from stages.references.groups import Job
from stages.references.pass_times import compile_passes, single_views, time_passes


class SinglePasses:
    """Passes of SPPM for a single view, for each of the novel views."""

    def __init__(self, work: Workspace) -> None:
        self.passes = work.params.reference.passes
        self.renderers = single_views(Job.open(work))
        compile_passes(self.renderers)

    def seconds(self, parts: int, k: int, samples: int = 4) -> float:
        """Mean seconds per pass, over views and over passes of the ``k``-th of ``parts`` parts."""
        passes = range(1 + self.passes * k // parts, 1 + self.passes * (k + 1) // parts)
        return float(time_passes(self.renderers, passes, samples).mean())
