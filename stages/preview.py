"""`gpf scene preview`: what the views of a scene see, before anything long is started."""

from __future__ import annotations

import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table

from gpf.preview import Preview, choose_views, draw_contact_sheet, render_previews
from gpf.runtime import choose_variant
from gpf.scenes import freeze_scene, load_scene_file, load_views, scenes_root
from stages.progress import progress_bar


def preview_scene(name: str, out: Path | None, height: int, passes: int) -> None:
    """Write a contact sheet of a scene's views and print what they see."""
    choose_variant("auto")
    views = load_views(name)
    out = out or scenes_root().parent / "results" / name / "preview.png"
    with tempfile.TemporaryDirectory(prefix="gpf-preview-") as folder:
        # As the pipeline does it: complete, whatever has been built in the scene's folder.
        frozen = Path(folder) / name
        freeze_scene(name, frozen)
        scene = load_scene_file(frozen / "scene.xml", *views.size(height))
    steps = passes + len(choose_views(views))
    with progress_bar(f"{name}: preview", steps) as advance:
        done = 0

        def tick() -> None:
            nonlocal done
            done += 1
            advance(done)

        previews = render_previews(scene, views, height=height, passes=passes, tick=tick)
    title = f"{name}: path tracer (left) and SPPM, {passes} passes (right)"
    draw_contact_sheet(out, title, previews, views.exposure)
    console = Console(highlight=False, soft_wrap=True)
    console.print(_table(previews))
    console.print(f"{out} has the pictures")


def _table(previews: list[Preview]) -> Table:
    table = Table("view", "for", "ends on diffuse", "of that lit", "faults")
    for preview in previews:
        report = preview.report
        table.add_row(
            preview.view.name,
            preview.use,
            f"{100 * report.diffuse_share:.0f}%",
            f"{100 * report.lit_share:.0f}%",
            "; ".join(report.faults()) or "none",
        )
    return table
