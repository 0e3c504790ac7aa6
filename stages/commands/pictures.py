"""`gpf render`: pictures of any view, or of a camera path, from a field that has been trained."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from gpf.core.errors import UserError
from gpf.core.images import write_exr, write_png
from gpf.core.progress import progress_bar, say
from gpf.scene.views import View
from stages.common.workspace import Workspace
from stages.render import FieldRenderer, tell_of_coverage


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
    section = work.params.render
    height, spp = height or work.params.film.height, spp or section.spp
    renderer = FieldRenderer.open(work, height, spp)
    shares, start = {}, time.perf_counter()
    with progress_bar(f"{scene}: pictures", len(views)) as advance:
        for k, view in enumerate(views):
            picture = renderer.render(view, section.seed + k)
            layers = {"radiance": picture.radiance, "coverage": picture.coverage}
            record = {"method": "gpf", "spp": spp, "view": view.model_dump(mode="json")}
            write_exr(folder / f"{view.name}.exr", layers, record)
            write_png(folder / f"{view.name}.png", picture.radiance, work.views.exposure)
            shares[view.name] = picture.weakly_covered
            advance(k + 1)
    seconds = (time.perf_counter() - start) / len(views)
    tell_of_coverage(scene, shares)
    what = f"{len(views)} picture{'s' if len(views) > 1 else ''}"
    say(f"{folder}: {what}, {seconds:.2f} s each")


def _choose(work: Workspace, names: Sequence[str], frames: bool) -> list[View]:
    """Novel views, if nothing is named."""
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
