"""Stage `render`: novel views from the fitted field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.images import check_finite, write_exr, write_png
from gpf.core.progress import progress_bar, say
from gpf.field.io import load_field
from gpf.rendering.batches import render_in_batches
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from stages.common.costs import CostMeter
from stages.common.timing_baseline import time_path
from stages.common.workspace import Workspace

# A pixel is weakly covered where the field had to reach so many search radii for its neighbours.
WEAK_REACH = 1.5


def render_views(scene_name: str) -> None:
    """Render every novel view from the scene's field."""
    render_novel_views(Workspace.open(scene_name))


def render_novel_views(work: Workspace) -> None:
    """Render every novel view, as EXR and as a preview."""
    section, views = work.params.render, work.views.novel
    if not views:
        raise UserError(
            str(work.views_file), "has no novel views", "Add some: they are what is rendered."
        )
    renderer = FieldRenderer.open(work, work.params.film.height, section.spp)
    costs, shares = CostMeter(), {}
    with progress_bar(f"{work.scene}: rendering", len(views)) as advance:
        for k, view in enumerate(views):
            with costs.measure("render"):
                picture = renderer.render(view, section.seed + k)
            record = {"method": "gpf", "spp": section.spp, "view": view.model_dump(mode="json")}
            path = work.render("gpf", view.name)
            layers = {"radiance": picture.radiance, "coverage": picture.coverage}
            write_exr(path, layers, record)
            write_png(path.with_suffix(".png"), picture.radiance, work.views.exposure)
            shares[view.name] = picture.weakly_covered
            advance(k + 1)
    tell_of_coverage(work.scene, shares)
    costs.facts |= {"views": len(views), "spp": section.spp}
    costs.facts["weakly_covered"] = list(shares.values())
    costs.facts["field_megabytes"] = work.field.stat().st_size / 1e6
    costs.note_peak_memory()
    costs.facts["path_seconds"] = time_path(renderer.scene, views[0], work.film_size)
    costs.write(work.cost("render"))


@dataclass(frozen=True)
class Picture:
    """A view from the field.

    Attributes
    ----------
    radiance: W/(m² sr), (H, W, 3).
    coverage: how far the field had to reach, in search radii; 0 where it was not asked, (H, W).
    """

    radiance: np.ndarray
    coverage: np.ndarray

    @property
    def weakly_covered(self) -> float:
        """The share of the pixels where the field has little to go by."""
        return float(np.mean(self.coverage > WEAK_REACH))


@dataclass(frozen=True)
class FieldRenderer:
    """A scene with its field, ready for any view, ``height`` pixels high, ``spp`` samples each."""

    work: Workspace
    scene: Any
    integrator: Any
    height: int
    spp: int

    @classmethod
    def open(cls, work: Workspace, height: int, spp: int) -> FieldRenderer:
        """Load the scene and its field, and say so if the one is not made for the other."""
        section, scene = work.params.render, work.load_scene()
        integrator = mi.load_dict(
            {
                "type": "gpf",
                "rr_depth": section.rr_depth,
                "glossy_walks": section.glossy_walks,
                "adaptive": section.adaptive,
                "suppress_fireflies": section.suppress_fireflies,
                "coverage": True,
            }
        )
        integrator.field = load_field(work.field)
        tell_of_another_scene(work, integrator.field.record)
        return cls(work, scene, integrator, height, spp)

    def render(self, view: View, seed: int) -> Picture:
        """One view."""
        size, sampler = self.work.views.size(self.height), self.work.params.render.sampler
        sensor = make_sensor(view, *size, spp=self.spp, sampler=sampler)
        image = render_in_batches(self.scene, self.integrator, sensor, self.spp, seed)
        check_finite(image[..., :3], f"{self.work.scene}, view {view.name}")
        return Picture(image[..., :3], image[..., 3])


def tell_of_coverage(scene: str, shares: Mapping[str, float]) -> None:
    """Say how much of the pictures the field knows little about."""
    worst = max(shares, key=shares.__getitem__)
    mean = sum(shares.values()) / len(shares)
    say(
        f"{scene}: {mean:.2%} of the pixels look where the field has little to go by (channel "
        f"coverage above {WEAK_REACH:g}); in the view {worst}, {shares[worst]:.2%}"
    )


def tell_of_another_scene(work: Workspace, record: Mapping[str, Any]) -> None:
    """Say so where the field was not trained in the scene as it is; a field may not know."""
    trained_in = record.get("scene", work.scene_digest)
    if trained_in != work.scene_digest:
        say(
            f"{work.field} was trained in another scene, or before this one was changed (scene "
            f"{trained_in}, here {work.scene_digest}): the images have the light of that one. "
            f"`gpf stage train --scene {work.scene}` makes a new field."
        )
