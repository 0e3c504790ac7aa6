"""`python -m benchmarks.scenes COMMAND`: cameras around any scene, and scenes made by others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from PIL import Image, ImageDraw, ImageFont

from benchmarks import check_scenes, cli
from benchmarks.foreign_rooms import fetch
from benchmarks.measured_scenes import MeasuredScene, open_scene
from benchmarks.truth import sppm
from gpf.core.images import tone_map
from gpf.core.progress import progress_bar
from gpf.scene.folders import list_scenes

ROWS, GAP, PASSES = 72, 4, 24


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
    width = max(strip.width for strip in strips)
    joined = Image.new("RGB", (width, sum(strip.height for strip in strips)), "white")
    y = 0
    for strip in strips:
        joined.paste(strip, (0, y))
        y += strip.height
    joined.save(sheet)


def draw_strip(measured: MeasuredScene) -> Image.Image:
    """The scene's name above pictures of its views."""
    placed, (width, height) = measured.placed, measured.size(ROWS)
    views = [*placed.train, *placed.novel, *placed.frames()[::6]]
    renderer = sppm(measured.scene, measured.sensors(views, ROWS))
    with progress_bar(measured.name, PASSES) as bar:
        sums = renderer.run(PASSES, tick=bar)
    strip = Image.new("RGB", (len(views) * (width + GAP), height + 18), "white")
    draw, font = ImageDraw.Draw(strip), ImageFont.load_default(12)
    counts = f"{len(placed.train)} training, {len(placed.novel)} novel, frames of the path"
    draw.text((0, 2), f"{measured.name.replace('_', ' ')}: {counts}", "black", font)
    for k in range(len(views)):
        shown = tone_map(renderer.image(f"{k}", sums), placed.exposure)
        picture = Image.fromarray(np.round(255 * shown).astype(np.uint8))
        strip.paste(picture, (k * (width + GAP), 18))
    return strip


app = cli.make_app(placement, fetch)

if __name__ == "__main__":
    cli.run(app)
