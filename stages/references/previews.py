"""Previews: pictures of the references in ``results/SCENE/preview`` while they are rendered."""

from __future__ import annotations

import time

import numpy as np

from gpf.core.images import write_png
from gpf.core.progress import say
from stages.common.workspace import Workspace
from stages.references.pass_sums import PassSums, ViewTally
from stages.references.renderer import ReferenceRenderer


class Previews:
    """The previews of one group; none with ``preview_seconds: 0``."""

    def __init__(self, work: Workspace, group: str, renderer: ReferenceRenderer) -> None:
        self.work, self.group, self.renderer = work, group, renderer
        self.updated = time.monotonic()

    def update_if_due(self, *sums: PassSums) -> float | None:
        """Call :meth:`update` if the last update was at least ``preview_seconds`` ago."""
        seconds = self.work.params.progress.preview_seconds
        return self.update(*sums) if time.monotonic() - self.updated >= seconds else None

    def update(self, *sums: PassSums) -> float | None:
        """Write a picture of each view from the passes in all of ``sums``.

        Returns the lowest :meth:`ViewTally.expected_psnr` of all views, dB, or None if nothing was
        written.
        """
        passes = sum(part.passes for part in sums)
        if not self.work.params.progress.preview_seconds or not passes or not self.renderer.sizes:
            return None
        folder, exposure, lowest = self.work.folder / "preview", self.work.views.exposure, np.inf
        for name, (width, height) in self.renderer.sizes.items():
            tally = ViewTally(width * height)
            for part in sums:
                tally.add_tally(part.views[name])
            lowest = min(lowest, tally.expected_psnr(passes, exposure))
            path, first = folder / f"{self.group}-{name}.png", not any(folder.glob("*.png"))
            write_png(path, tally.mean(passes).reshape(height, width, 3), exposure)
            if first:
                say(f"{self.work.scene}: first picture: {path}")
        self.updated = time.monotonic()
        return lowest
