"""The passes of one group: rendered in ranges, saved as they grow, and added up exactly."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gpf.core.images import check_finite
from gpf.core.progress import Bar, progress_bar
from gpf.training.targets import SURFACES
from metrics.equivalent_passes import snapshot_passes
from stages.common.costs import KINDS, CostMeter
from stages.common.workspace import Workspace
from stages.references.pass_files import PassParts
from stages.references.pass_sums import PassSums
from stages.references.previews import Previews
from stages.references.renderer import ReferenceRenderer

# With ``target_psnr``, the noise is measured each time this many more passes are done.
CHECK_EVERY = 25


@dataclass
class GroupPasses:
    """Passes 1 to ``passes`` of one group of views and points.

    Attributes
    ----------
    group: name of the group, and of its part of the costs.
    renderer: renders the passes.
    parts: ranges of passes that are done.
    costs: receives the cost of the passes.
    """

    work: Workspace
    group: str
    renderer: ReferenceRenderer
    parts: PassParts
    costs: CostMeter

    def __post_init__(self) -> None:
        self.title = f"{self.work.scene}: references ({self.group})"
        self.previews = Previews(self.work, self.group, self.renderer)

    @property
    def passes(self) -> int:
        """Largest number of passes."""
        return self.work.params.reference.passes

    def cuts(self) -> list[int]:
        """Numbers of passes at which parts end, because a snapshot or the noise is needed."""
        cuts = set(snapshot_passes(self.passes))
        if self.work.params.reference.target_psnr > 0:
            cuts |= set(range(CHECK_EVERY, self.passes, CHECK_EVERY))
        return sorted(cuts)

    def render(self, wanted: range) -> None:
        """Render the missing passes of a range (0-based), and save every part."""
        seconds = self.work.params.progress.checkpoint_seconds
        todo = self.parts.missing(wanted, self.cuts())
        done = len(wanted) - sum(map(len, todo))
        total = self.renderer.empty_sums()
        with progress_bar(self.title, len(wanted)) as bar:
            bar(done)
            for part in todo:
                if total.passes < part.start:  # earlier runs made the passes before this part
                    total = self.merge()
                if total.passes == part.start and self.is_good_enough(total):
                    break
                self.costs.parts.pop(self.group, None)
                with self.costs.measure(self.group):
                    sums, saved = self.renderer.empty_sums(), time.monotonic()
                    for t in part:
                        self.renderer.run_pass(t + 1, sums)
                        done += 1
                        bar(done)
                        self.update_previews(bar, total, sums)
                        if time.monotonic() - saved > seconds and t + 1 < part.stop:
                            self.save(range(part.start, t + 1), sums, self.costs.so_far(self.group))
                            saved = time.monotonic()
                self.save(part, sums, self.costs.parts[self.group])
                total.add_tensors(sums.tensors(), sums.passes)
        self.costs.parts.pop(self.group, None)

    def update_previews(self, bar: Bar, *sums: PassSums) -> None:
        """Update the previews if they are due, and the expected PSNR beside the progress bar."""
        psnr = self.previews.update_if_due(*sums)
        if psnr is not None and np.isfinite(psnr):  # infinite after one pass, or without noise
            bar.describe(f"{self.title}, {psnr:.1f} dB")

    def save(self, part: range, sums: PassSums, costs: Mapping[str, float]) -> None:
        """Write the sums of a part.

        Raises
        ------
        UserError: a value is not finite; further passes cannot repair it.
        """
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
        """The sum of the passes before the first missing one; calls ``at(sums)`` after each part.

        Stops earlier if the noise is low enough. The costs of the parts become those of the group.
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
        """The sum of all passes, and the views' images after ``snapshots`` passes.

        None if passes are missing and the noise is not low enough yet.
        """
        images: dict[str, dict[str, np.ndarray]] = {name: {} for name in self.renderer.sensors}

        def take_snapshot(sums: PassSums) -> None:
            if sums.passes in snapshots or self.is_good_enough(sums):
                for name, layers in images.items():
                    layers[f"sppm_{sums.passes}"] = self.renderer.image(name, sums)

        sums = self.merge(take_snapshot)
        if sums.passes < self.passes and not self.is_good_enough(sums):
            return None
        self.previews.update(sums)
        return sums, images

    def is_good_enough(self, sums: PassSums) -> bool:
        """Whether passes 1 to n have so little noise that ``target_psnr`` is reached."""
        # Only where parts end anyway, so that an interrupted run stops at the same pass.
        target = self.work.params.reference.target_psnr
        if not target or not sums.views or sums.passes not in self.cuts():
            return False
        exposure = self.work.views.exposure
        lowest = min(view.expected_psnr(sums.passes, exposure) for view in sums.views.values())
        return sums.passes >= CHECK_EVERY and lowest >= target
