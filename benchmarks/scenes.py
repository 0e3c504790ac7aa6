"""`python -m benchmarks.scenes COMMAND`: cameras around any scene, and scenes made by others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from PIL import Image

from benchmarks import check_scenes, cli
from benchmarks.foreign_rooms import fetch
from benchmarks.measured_scenes import MeasuredScene, open_scene
from benchmarks.pictures import side_by_side, stacked
from benchmarks.truth import sppm
from gpf.core.images import tone_map
from gpf.core.progress import progress_bar
from gpf.scene.folders import list_scenes

ROWS, PASSES = 72, 24


def placement(
    scenes: cli.Scenes = None,
    sheet: Annotated[Path, typer.Option(help="The PNG to write.")] = Path("sheet.png"),
) -> None:
    """Pictures of the views that are placed around each scene: training, novel, some of the path.

    Of the scenes of `scenes/`, only the first training view is used.
    """
    strips = [
        draw_strip(open_scene(name)) for name in scenes or [*check_scenes.SCENES, *list_scenes()]
    ]
    stacked(strips).save(sheet)


def draw_strip(measured: MeasuredScene) -> Image.Image:
    """The scene's name above pictures of its views."""
    placed = measured.placed
    views = [*placed.train, *placed.novel, *placed.frames()[::6]]
    renderer = sppm(measured.scene, measured.sensors(views, ROWS))
    with progress_bar(measured.name, PASSES) as bar:
        sums = renderer.run(PASSES, tick=bar)
    counts = f"{len(placed.train)} training, {len(placed.novel)} novel, frames of the path"
    images = [renderer.image(f"{k}", sums) for k in range(len(views))]
    shown = [tone_map(image, placed.exposure) for image in images]
    return side_by_side(shown, [f"{measured.name.replace('_', ' ')}: {counts}"])


app = cli.make_app(placement, fetch)

if __name__ == "__main__":
    cli.run(app)
