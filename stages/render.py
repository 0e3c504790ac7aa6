"""Stage `render`: novel views from the fitted field."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gpf.core.images import write_exr, write_png
from gpf.core.progress import progress_bar, say
from gpf.field.io import load_field
from gpf.rendering.field_renderer import FieldRenderer, describe_coverage, weakly_covered
from stages.common.costs import CostMeter
from stages.common.timing_baseline import time_path
from stages.common.workspace import Workspace


def run(scene_name: str) -> None:
    """Render every novel view from the scene's field."""
    render_novel_views(Workspace.open(scene_name))


def render_novel_views(work: Workspace) -> None:
    """Render every novel view, as EXR and PNG, and write the costs."""
    views, settings = work.novel_views(), work.params.render
    renderer, costs, shares = open_renderer(work, settings.spp), CostMeter(), {}
    with progress_bar(f"{work.scene}: rendering", len(views)) as advance:
        for k, view in enumerate(views):
            with costs.measure("render"):
                layers = renderer.render(view, work.film_size, settings.seed + k)
            record = {"method": "gpf", "spp": settings.spp, "view": view.model_dump(mode="json")}
            file = work.render("gpf", view.name)
            write_exr(file, layers, record)
            write_png(file.with_suffix(".png"), layers["radiance"], work.views.exposure)
            shares[view.name] = weakly_covered(layers["coverage"])
            advance(k + 1)
    say(f"{work.scene}: {describe_coverage(shares)}")
    costs.facts |= {"views": len(views), "spp": settings.spp}
    costs.facts["weakly_covered"] = list(shares.values())
    costs.facts["field_megabytes"] = work.field.stat().st_size / 1e6
    costs.note_peak_memory()
    costs.facts["path_seconds"] = time_path(renderer.scene, views[0], work.film_size)
    costs.write(work.cost("render"))


def open_renderer(work: Workspace, spp: int) -> FieldRenderer:
    """A renderer with the scene and its field, for images with ``spp`` samples per pixel and their
    coverage; prints a message if the field is from another scene."""
    field, settings = load_field(work.field), work.params.render
    report_other_scene(work, field.record)
    scene = work.load_scene()
    return FieldRenderer.make(scene, field, settings.model_copy(update={"spp": spp}), ["coverage"])


def report_other_scene(work: Workspace, record: Mapping[str, Any]) -> None:
    """Print a message if the field was not trained in the current scene; older fields do not
    record it."""
    trained_in = record.get("scene", work.scene_digest)
    if trained_in != work.scene_digest:
        say(
            f"{work.field} was trained in another scene, or before this scene was changed (scene "
            f"{trained_in}, here {work.scene_digest}): the images show the light of that scene. "
            f"`gpf stage train --scene {work.scene}` makes a new field."
        )
