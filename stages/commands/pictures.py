"""`gpf render`: pictures of any view, or of the camera path, from the field of a trained scene."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from gpf.core.errors import UserError
from gpf.core.progress import say
from gpf.scene.views import View
from stages.common.costs import CostMeter
from stages.common.workspace import Workspace
from stages.render import FieldRenderer, report_coverage


def render_pictures(
    scene: str,
    names: Sequence[str],
    frames: bool,
    out: Path | None,
    height: int | None,
    spp: int | None,
) -> None:
    """Write the views with the given names, or the frames of the path, as EXR and PNG."""
    work = Workspace.open(scene)
    views = _choose(work, names, frames)
    folder = out or work.folder / "pictures"
    height, spp = height or work.params.film.height, spp or work.params.render.spp
    renderer, start = FieldRenderer.open(work, height, spp), time.perf_counter()
    shares = renderer.write(views, folder, CostMeter())
    seconds = (time.perf_counter() - start) / len(views)
    report_coverage(scene, shares)
    what = f"{len(views)} picture{'s' if len(views) > 1 else ''}"
    say(f"{folder}: {what}, {seconds:.2f} s each")


def _choose(work: Workspace, names: Sequence[str], frames: bool) -> list[View]:
    """The named views and the frames; without either, the novel views."""
    path = list(work.views.frames())
    if frames and not path:
        raise UserError(
            str(work.views_file), "has no camera path", "Add a path, or name views with --view."
        )
    chosen = [*(path if frames else []), *(work.views.find(name) for name in names)]
    chosen = chosen or list(work.views.novel)
    if not chosen:
        raise UserError(
            str(work.views_file), "has no novel views", "Name a view with --view, or --frames."
        )
    return chosen
