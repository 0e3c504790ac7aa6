"""`gpf scene preview`: small pictures of a scene's views, to check them before the pipeline."""

from __future__ import annotations

import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table

from gpf.core.errors import UserError
from gpf.core.progress import progress_bar
from gpf.core.runtime import choose_variant
from gpf.scene.folders import load_views, scenes_root
from gpf.scene.load import load_scene_file
from gpf.scene.snapshot import snapshot_scene
from stages.config.params import read_params
from stages.importing.preview import Preview, choose_views, draw_contact_sheet, render_previews


def preview_scene(name: str, out: Path | None, height: int, passes: int, whole: bool) -> None:
    """Write a contact sheet of a scene's views, and print what they see and their faults."""
    if out is not None and out.suffix.lower() != ".png":
        raise UserError(f"--output {out}", "is not a PNG", "Give it a name that ends in .png.")
    project = scenes_root().parent
    params = project / "params.yaml"
    choose_variant(read_params(params).runtime.variant if params.exists() else "auto")
    views = load_views(name)
    chosen = choose_views(views, whole)
    out = out or project / "results" / name / "preview.png"
    with tempfile.TemporaryDirectory(prefix="gpf-preview-") as folder:
        # As in the pipeline: a complete copy, independent of files built in the scene's folder.
        snapshot = Path(folder) / name
        snapshot_scene(name, snapshot)
        scene = load_scene_file(snapshot / "scene.xml", *views.size(height))
    with progress_bar(f"{name}: preview", passes + len(chosen)) as advance:
        done = 0

        def tick() -> None:
            nonlocal done
            done += 1
            advance(done)

        previews = render_previews(scene, views, chosen, height=height, passes=passes, tick=tick)
    title = f"{name}: path tracer (left) and SPPM, {passes} passes (right)"
    draw_contact_sheet(out, title, previews, views.exposure)
    console = Console(highlight=False, soft_wrap=True)
    console.print(_table(previews))
    total = len(views.train) + len(views.novel)
    shown = sum(use != "path" for _, use in chosen)
    rest = f"; --all shows all {total} views" if shown < total else ""
    console.print(f"pictures: {out}{rest}")


def _table(previews: list[Preview]) -> Table:
    table = Table("view", "for", "diffuse", "of which lit", "faults")
    for preview in previews:
        report = preview.report
        table.add_row(
            preview.view.name,
            preview.use,
            f"{100 * report.diffuse_share:.0f}%",
            f"{100 * report.lit_share:.0f}%",
            "; ".join(preview.faults) or "none",
        )
    return table
