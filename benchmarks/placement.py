"""`python -m benchmarks.placement [--sheet FILE] [SCENE …]`: cameras placed around a scene.

For each scene: seconds of the placement, the share of the pixels that show light in the scene's own
view and in the placed ones (least and mean), and how many views are below 80 %. The scenes are
those of `benchmarks/check_scenes.py` and of `scenes/`; of the latter, only the first training view
is used.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import mitsuba as mi
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from rich.console import Console
from rich.table import Table

from benchmarks.check_scenes import SCENES, load
from gpf.core.images import tone_map
from gpf.core.progress import progress_bar
from gpf.importing.placement import place_views
from gpf.importing.report import PHOTONS
from gpf.importing.view_checks import report_views
from gpf.photons.tracing import PathSettings
from gpf.scene.folders import list_scenes, load_views
from gpf.scene.load import load_scene_file
from gpf.scene.sensors import film_aspect, make_sensor, views_of_sensors
from gpf.scene.snapshot import snapshot_scene
from gpf.scene.views import SceneViews, View
from gpf.sppm.passes import PassSettings, propose_radius
from gpf.sppm.reference import ReferenceRenderer

ROWS, GAP = 72, 4


def main() -> None:
    """Place cameras in the scenes, print the table, and draw the contact sheet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sheet", type=Path, help="write pictures of all views to this PNG")
    parser.add_argument("scenes", nargs="*", default=[*SCENES, *list_scenes()])
    arguments = parser.parse_args()
    table = Table("scene", "seconds", "own view", "least", "mean", "below 80%")
    strips = []
    for name in arguments.scenes:
        scene, own, aspect = open_scene(name)
        start = time.perf_counter()
        placed = place_views(scene, [own], aspect)
        seconds = time.perf_counter() - start
        views = [*placed.train, *placed.novel, *placed.frames()[::6]]
        shares = [r.light_share for r in report_views(scene, [own, *views], aspect, seed=77)]
        table.add_row(
            name,
            f"{seconds:.1f}",
            *(f"{100 * share:.0f}%" for share in (shares[0], min(shares[1:]), np.mean(shares[1:]))),
            f"{sum(share < 0.8 for share in shares[1:])} of {len(views)}",
        )
        if arguments.sheet:
            strips.append(draw_strip(name, scene, placed, views))
    Console(width=100).print(table)
    if arguments.sheet:
        width = max(strip.width for strip in strips)
        sheet = Image.new("RGB", (width, sum(strip.height for strip in strips)), "white")
        y = 0
        for strip in strips:
            sheet.paste(strip, (0, y))
            y += strip.height
        sheet.save(arguments.sheet)


def open_scene(name: str) -> tuple[mi.Scene, View, float]:
    """A scene, its own camera, and the width of images divided by their height."""
    if name in SCENES:
        scene = load(name)
        return scene, views_of_sensors(scene)[0], film_aspect(scene.sensors()[0])
    views = load_views(name)
    with tempfile.TemporaryDirectory() as folder:
        snapshot_scene(name, Path(folder) / name)
        scene = load_scene_file(Path(folder) / name / "scene.xml", *views.size(ROWS))
    return scene, views.train[0], views.aspect


def draw_strip(
    name: str, scene: mi.Scene, placed: SceneViews, views: list[View], passes: int = 24
) -> Image.Image:
    """The scene's name above pictures of the views: training, novel, frames of the path."""
    width, height = placed.size(ROWS)
    sensors = {f"{k}": make_sensor(view, width, height) for k, view in enumerate(views)}
    points = report_views(scene, views[:1], placed.aspect)[0].points
    radius = propose_radius(scene, points, PathSettings(PHOTONS), photons_in_disc=8)
    settings = PassSettings(photons_per_pass=PHOTONS, initial_radius=radius, direct="photons")
    renderer = ReferenceRenderer(scene, sensors, {}, settings, seed=0)
    with progress_bar(name, passes) as bar:
        sums = renderer.run(passes, tick=bar)
    strip = Image.new("RGB", (len(views) * (width + GAP), height + 18), "white")
    draw, font = ImageDraw.Draw(strip), ImageFont.load_default(12)
    counts = f"{len(placed.train)} training, {len(placed.novel)} novel, frames of the path"
    draw.text((0, 2), f"{name.replace('_', ' ')}: {counts}", "black", font)
    for k in range(len(views)):
        shown = tone_map(renderer.image(f"{k}", sums), placed.exposure)
        picture = Image.fromarray(np.round(255 * shown).astype(np.uint8))
        strip.paste(picture, (k * (width + GAP), 18))
    return strip


if __name__ == "__main__":
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    main()
