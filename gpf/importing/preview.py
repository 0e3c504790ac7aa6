"""A contact sheet of a scene's views: path tracer and SPPM side by side, and what is wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np

from gpf.core.files import write_atomically
from gpf.core.images import tone_map
from gpf.importing.view_checks import ViewReport, report_views
from gpf.scene.sensors import make_sensor
from gpf.scene.views import SceneViews, View
from gpf.sppm.passes import PassSettings, propose_radius
from gpf.sppm.reference import ReferenceRenderer

_DEPTH = 16
PHOTONS = 100_000
_COLUMNS = 4


@dataclass(frozen=True)
class Preview:
    """One view as two methods see it.

    Attributes
    ----------
    use: what it is for: train, novel or path.
    faults: what speaks against the view, in words.
    path, sppm: linear radiance, (H, W, 3).
    """

    view: View
    use: str
    report: ViewReport
    faults: list[str]
    path: np.ndarray
    sppm: np.ndarray


def render_previews(
    scene: mi.Scene,
    views: SceneViews,
    chosen: Sequence[tuple[View, str]],
    height: int = 96,
    spp: int = 16,
    passes: int = 8,
    tick: Callable[[], None] = lambda: None,
) -> list[Preview]:
    """Render views side by side; ``tick()`` after each of ``passes`` + V steps for V views.

    All views share the photons of a pass.
    """
    size = views.size(height)
    reports = report_views(scene, [view for view, _ in chosen], views.aspect)
    sensors = {view.name: make_sensor(view, *size, spp=spp) for view, _ in chosen}
    # Small: where the first view is dim, others may be bright, and full of photons.
    photons = PHOTONS
    radius = propose_radius(scene, reports[0].points, photons, photons_in_disc=4)
    settings = PassSettings(photons_per_pass=PHOTONS, initial_radius=radius, direct="photons")
    photon_mapping = ReferenceRenderer(scene, sensors, {}, settings, seed=0)
    photon_mapping.run(passes, lambda _: tick())
    tracer = mi.load_dict({"type": "path", "max_depth": _DEPTH})
    previews = []
    for (view, use), report in zip(chosen, reports, strict=True):
        image = np.array(mi.render(scene, sensor=sensors[view.name], integrator=tracer, spp=spp))
        mapped = photon_mapping.image(view.name)
        # The first camera is where its author wants it: under water, for instance.
        faults = report.faults(home_inside=reports[0].inside)
        previews.append(Preview(view, use, report, faults, image, mapped))
        tick()
    return previews


def choose_views(views: SceneViews, whole: bool = False) -> list[tuple[View, str]]:
    """The views of a contact sheet, each with what it is for.

    Those are, unless ``whole``, at most 8 training views, spread over all, further ones, the novel
    views, and three frames of the path.
    """
    train, frames = views.train, views.frames()
    if not whole:
        train = train[:: -(-len(train) // 8)]
        frames = frames[:: max(1, len(frames) // 3)]
    kinds = {"train": train, "more": views.more, "novel": views.novel, "path": frames}
    return [(view, use) for use, members in kinds.items() for view in members]


def draw_contact_sheet(
    path: Path, title: str, previews: Sequence[Preview], exposure: float
) -> None:
    """Write a PNG with a pair of pictures for each view: path tracer left, SPPM right."""
    from matplotlib.figure import Figure

    height, width = previews[0].path.shape[:2]
    columns = min(_COLUMNS, len(previews))
    rows = -(-len(previews) // columns)
    lines = 1 + max(len(preview.faults) for preview in previews)
    # Inches: a line of words above each row, the title above all.
    words, title_height = 0.12 * lines, 0.3
    total = rows * (height / 100 + words) + title_height
    figure = Figure(figsize=(columns * (2 * width + 8) / 100, total), dpi=100)
    figure.suptitle(title, x=0.004, y=1 - 0.06 / total, ha="left", va="top", fontsize=9)
    grid = figure.subplots(rows, columns, squeeze=False)
    figure.subplots_adjust(
        left=0.004,
        right=0.996,
        bottom=0,
        top=1 - (title_height + words) / total,
        wspace=0.02,
        hspace=words / (height / 100),
    )
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, preview in zip(grid.flat, previews, strict=False):
        gap = np.ones((height, 4, 3))
        pair = [tone_map(image, exposure) for image in (preview.path, preview.sppm)]
        axes.imshow(np.concatenate([pair[0], gap, pair[1]], axis=1), interpolation="nearest")
        faults = preview.faults
        label = f"{preview.use}: {preview.view.name}"
        axes.set_title(
            "\n".join([label, *faults]),
            fontsize=7,
            loc="left",
            pad=2,
            color="crimson" if faults else "black",
        )
    write_atomically(path, lambda file: figure.savefig(file, format="png"))
