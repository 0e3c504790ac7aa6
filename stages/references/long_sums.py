"""Long sums of passes: rendered in ranges, kept as they grow, watched, and added up exactly."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gpf.core.images import check_finite, write_png
from gpf.core.progress import progress_bar
from gpf.sppm.pass_files import PassParts
from gpf.sppm.pass_sums import PassSums, ViewTally
from gpf.sppm.reference import ReferenceRenderer
from gpf.training.targets import SURFACES
from metrics.equivalent_passes import snapshot_passes
from stages.common.costs import KINDS, CostMeter
from stages.common.workspace import Workspace

# With a target for the noise, it is looked at whenever so many more passes are done.
CHECK_EVERY = 25


@dataclass
class LongSum:
    """Passes 1 to ``passes`` of one group of views and points.

    Attributes
    ----------
    group: name of the group, which is the name of its cost as well.
    renderer: renders the passes.
    parts: the ranges that are done.
    """

    work: Workspace
    group: str
    renderer: ReferenceRenderer
    parts: PassParts
    costs: CostMeter

    @property
    def passes(self) -> int:
        """How many there are to be at most."""
        return self.work.params.reference.passes

    def cuts(self) -> list[int]:
        """Numbers of passes at which something is read off, and parts end."""
        cuts = set(snapshot_passes(self.passes))
        if self.work.params.reference.target_psnr > 0:
            cuts |= set(range(CHECK_EVERY, self.passes, CHECK_EVERY))
        return sorted(cuts)

    def render(self, wanted: range) -> None:
        """Render what is missing of a range of passes (0-based); every part is kept."""
        section = self.work.params.reference
        todo = self.parts.missing(wanted, self.cuts())
        done = len(wanted) - sum(map(len, todo))
        title = f"{self.work.scene}: {self.group} references"
        with progress_bar(title, len(wanted)) as bar:
            bar(done)
            total = self.merge() if todo and todo[0].start > 0 else self.renderer.empty_sums()
            watch = Watch(self, total, bar.describe)
            for part in todo:
                if total.passes < part.start:  # parts that others made lie between
                    total = watch.total = self.merge()
                if total.passes == part.start and self.is_good_enough(total):
                    break
                self.costs.parts.pop(self.group, None)
                with self.costs.measure(self.group):
                    sums, saved = self.renderer.empty_sums(), time.monotonic()
                    for t in part:
                        self.renderer.run_pass(t + 1, sums)
                        done += 1
                        bar(done)
                        watch.look(sums)
                        late = time.monotonic() - saved > section.checkpoint_seconds
                        if late and t + 1 < part.stop:
                            self.keep(range(part.start, t + 1), sums, self.costs.so_far(self.group))
                            saved = time.monotonic()
                self.keep(part, sums, self.costs.parts[self.group])
                total.add_tensors(sums.tensors(), sums.passes)
        self.costs.parts.pop(self.group, None)

    def keep(self, part: range, sums: PassSums, costs: Mapping[str, float]) -> None:
        """Write the sums of a part, unless they hold what can't be mended by further passes."""
        renderer = self.renderer
        for name in renderer.sensors:
            check_finite(renderer.image(name, sums), f"{self.work.scene}, view {name}, radiance")
        for name in renderer.points:
            where = f"{self.work.scene}, view {name}, irradiance"
            if name == SURFACES:
                where = f"{self.work.scene}, samples of its surfaces"
            check_finite(renderer.mean_irradiance(name, sums), where)
        self.parts.write(part, sums, costs)

    def merge(self, at: Callable[[PassSums], None] = lambda sums: None) -> PassSums:
        """The sum of all passes that are there without a gap; ``at(sums)`` after each part.

        It ends where the noise is low enough. Costs of the parts become the group's.
        """
        sums, spent = self.renderer.empty_sums(), dict.fromkeys(KINDS, 0.0)
        for part in self.parts.done():
            if part.start != sums.passes:
                break
            for kind, value in self.parts.add_to(sums, part).items():
                spent[kind] += value
            at(sums)
            if self.is_good_enough(sums):
                break
        self.costs.parts[self.group] = spent
        return sums

    def finish(
        self, snapshots: Sequence[int] = ()
    ) -> tuple[PassSums, dict[str, dict[str, np.ndarray]]] | None:
        """The sum of all parts, and the views' images after some numbers of passes.

        None while passes are missing: all of them, or as many as the target for the noise takes.
        """
        images: dict[str, dict[str, np.ndarray]] = {name: {} for name in self.renderer.sensors}

        def keep(sums: PassSums) -> None:
            if sums.passes in snapshots or self.is_good_enough(sums):
                for name, layers in images.items():
                    layers[f"sppm_{sums.passes}"] = self.renderer.image(name, sums)

        sums = self.merge(keep)
        complete = sums.passes >= self.passes or self.is_good_enough(sums)
        return (sums, images) if complete else None

    def expected_psnr(self, sums: PassSums) -> float:
        """The lowest of all views, dB (:meth:`gpf.sppm.pass_sums.ViewTally.expected_psnr`)."""
        exposure = self.work.views.exposure
        tallies = sums.views.values()
        return min(
            (tally.expected_psnr(sums.passes, exposure) for tally in tallies), default=np.inf
        )

    def is_good_enough(self, sums: PassSums) -> bool:
        """Whether passes 1 to n have so little noise that the target allows to stop there."""
        # Only where parts end in any case: an interrupted run must not stop elsewhere.
        target = self.work.params.reference.target_psnr
        if not target or not sums.views or sums.passes not in self.cuts():
            return False
        return sums.passes >= CHECK_EVERY and self.expected_psnr(sums) >= target


class Watch:
    """Shows, every few seconds, what the images look like and how much noise is left."""

    def __init__(self, long_sum: LongSum, total: PassSums, describe: Callable[[str], None]) -> None:
        self.long_sum, self.total, self.describe = long_sum, total, describe
        self.last = time.monotonic()

    def look(self, latest: PassSums) -> None:
        """Write previews if it is time to, of the total and of what came after it."""
        work, renderer = self.long_sum.work, self.long_sum.renderer
        seconds = work.params.reference.preview_seconds
        if not seconds or time.monotonic() - self.last < seconds or not renderer.sensors:
            return
        passes, worst = self.total.passes + latest.passes, np.inf
        for name in renderer.sensors:
            tally = ViewTally(self.total.views[name].squares.size)
            for sums in (self.total, latest):
                tally.add_tally(sums.views[name])
            worst = min(worst, tally.expected_psnr(passes, work.views.exposure))
            image = tally.mean(passes).reshape(*renderer.sizes[name][::-1], 3)
            path = work.folder / "preview" / f"{self.long_sum.group}-{name}.png"
            write_png(path, image, work.views.exposure)
        title = f"{work.scene}: {self.long_sum.group} references"
        self.describe(f"{title}, {worst:.1f} dB")
        self.last = time.monotonic()
