"""Stage `render`: novel views from the fitted field."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.field_files import load_field
from gpf.images import check_finite, write_exr, write_png
from stages.costs import CostMeter
from stages.progress import console, progress_bar
from stages.workspace import Workspace

# Camera samples that are in flight at once: some 2 GB of state.
LARGEST_WAVEFRONT = 1 << 26


def render_image(
    scene: mi.Scene, integrator: mi.Integrator, sensor: mi.Sensor, spp: int, seed: int
) -> np.ndarray:
    """An image as (H, W, C) float32, in as many parts of its samples as memory asks for."""
    width, height = sensor.film().crop_size()
    parts = -(-spp * int(width) * int(height) // LARGEST_WAVEFRONT)
    total: Any = 0
    done = 0
    for part in range(parts):
        share = (spp - done) // (parts - part)
        image = mi.render(
            scene, integrator=integrator, sensor=sensor, spp=share, seed=seed + part * 2**16
        )
        total = total + np.array(image) * (share / spp)
        done += share
    return np.asarray(total)


def render_views(scene_name: str) -> None:
    """Render every novel view, as EXR and as a preview."""
    work = Workspace.open(scene_name)
    section = work.params.render
    scene = work.load_scene()
    integrator = mi.load_dict(
        {
            "type": "gpf",
            "rr_depth": section.rr_depth,
            "glossy_walks": section.glossy_walks,
            "adaptive": section.adaptive,
            "coverage": True,
        }
    )
    integrator.field = load_field(work.field)
    tell_of_another_scene(work, integrator.field.record)
    costs = CostMeter()
    shares = []
    views = work.views.novel
    with progress_bar(f"{scene_name}: rendering", len(views)) as advance:
        for k, view in enumerate(views):
            sensor = work.sensor(view, section.spp, section.sampler)
            with costs.measure("render"):
                image = render_image(scene, integrator, sensor, section.spp, section.seed + k)
            radiance, coverage = image[..., :3], image[..., 3]
            check_finite(radiance, f"{scene_name}, view {view.name}")
            shares.append(float(np.mean(coverage > 1.5)))
            record = {"method": "gpf", "spp": section.spp, "view": view.model_dump(mode="json")}
            path = work.render("gpf", view.name)
            write_exr(path, {"radiance": radiance, "coverage": coverage}, record)
            write_png(path.with_suffix(".png"), radiance, work.views.exposure)
            advance(k + 1)
    costs.facts |= {"views": len(views), "spp": section.spp, "weakly_covered": shares}
    costs.facts["field_megabytes"] = work.field.stat().st_size / 1e6
    costs.write(work.cost("render"))


def tell_of_another_scene(work: Workspace, record: Mapping[str, Any]) -> None:
    """Say so where the field was not trained in the scene as it is; a field may not know."""
    trained_in = record.get("scene", work.scene_digest)
    if trained_in != work.scene_digest:
        console.print(
            f"{work.field} was trained in another scene, or before this one was changed (scene "
            f"{trained_in}, here {work.scene_digest}): the images have the light of that one. "
            f"`gpf stage train --scene {work.scene}` makes a new field.",
            highlight=False,
            soft_wrap=True,
        )
