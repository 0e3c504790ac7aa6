"""Stage `render`: novel views from the fitted field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.core.images import check_finite, write_exr, write_png
from gpf.core.progress import progress_bar, say
from gpf.field.io import load_field
from gpf.rendering.batches import render_in_batches
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from stages.common.costs import CostMeter
from stages.common.timing_baseline import time_path
from stages.common.workspace import Workspace

# A pixel is weakly covered if the farthest Gaussian of its query is this many search radii away.
WEAK_REACH = 1.5


def render_views(scene_name: str) -> None:
    """Render every novel view from the scene's field."""
    render_novel_views(Workspace.open(scene_name))


def render_novel_views(work: Workspace) -> None:
    """Render every novel view, as EXR and PNG, and write the costs."""
    views, spp = work.novel_views(), work.params.render.spp
    renderer = FieldRenderer.open(work, work.params.film.height, spp)
    costs = CostMeter()
    shares = renderer.write(views, work.renders("gpf"), costs)
    report_coverage(work.scene, shares)
    costs.facts |= {"views": len(views), "spp": spp}
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
    coverage: distance of the farthest Gaussian of the queries, in search radii, (H, W); 0 without
        a query.
    """

    radiance: np.ndarray
    coverage: np.ndarray

    @property
    def weakly_covered(self) -> float:
        """The share of weakly covered pixels."""
        return float(np.mean(self.coverage > WEAK_REACH))


@dataclass(frozen=True)
class FieldRenderer:
    """A scene with its field; renders any view at ``height`` rows with ``spp`` samples per
    pixel."""

    work: Workspace
    scene: Any
    integrator: Any
    height: int
    spp: int

    @classmethod
    def open(cls, work: Workspace, height: int, spp: int) -> FieldRenderer:
        """Load the scene and its field; print a message if the field is for another scene."""
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
        report_other_scene(work, integrator.field.record)
        return cls(work, scene, integrator, height, spp)

    def render(self, view: View, seed: int) -> Picture:
        """Render one view."""
        size, sampler = self.work.views.size(self.height), self.work.params.render.sampler
        sensor = make_sensor(view, *size, spp=self.spp, sampler=sampler)
        image = render_in_batches(self.scene, self.integrator, sensor, self.spp, seed)
        check_finite(image[..., :3], f"{self.work.scene}, view {view.name}")
        return Picture(image[..., :3], image[..., 3])

    def write(self, views: Sequence[View], folder: Path, costs: CostMeter) -> dict[str, float]:
        """Render views as ``NAME.exr`` and ``NAME.png``; the share of weakly covered pixels by
        view. ``costs`` gets the part ``render``."""
        shares = {}
        with progress_bar(f"{self.work.scene}: rendering", len(views)) as advance:
            for k, view in enumerate(views):
                with costs.measure("render"):
                    picture = self.render(view, self.work.params.render.seed + k)
                record = {"method": "gpf", "spp": self.spp, "view": view.model_dump(mode="json")}
                layers = {"radiance": picture.radiance, "coverage": picture.coverage}
                write_exr(folder / f"{view.name}.exr", layers, record)
                exposure = self.work.views.exposure
                write_png(folder / f"{view.name}.png", picture.radiance, exposure)
                shares[view.name] = picture.weakly_covered
                advance(k + 1)
        return shares


def report_coverage(scene: str, shares: Mapping[str, float]) -> None:
    """Print the share of weakly covered pixels."""
    worst = max(shares, key=shares.__getitem__)
    mean = sum(shares.values()) / len(shares)
    say(
        f"{scene}: {mean:.2%} of the pixels are weakly covered by Gaussians (channel coverage "
        f"above {WEAK_REACH:g}); in the view {worst}, {shares[worst]:.2%}"
    )


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
