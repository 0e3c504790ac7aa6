"""Any scene to measure, and its cameras."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

import gpf
from benchmarks import check_scenes, lit_scenes
from gpf.core.progress import progress_bar
from gpf.field.field import GaussianPhotonField
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.folders import load_views
from gpf.scene.load import load_scene_file
from gpf.scene.sensors import film_aspect, make_sensor, views_of_sensors
from gpf.scene.snapshot import snapshot_scene
from gpf.scene.views import SceneViews, View
from stages.importing.views import place_views

BUILT = {**check_scenes.SCENES, **lit_scenes.SCENES}
"""Scenes that functions build, by name."""


@dataclass(frozen=True)
class MeasuredScene:
    """A scene and its own camera.

    Attributes
    ----------
    aspect: width of images divided by their height.
    views: the views of a scene of `scenes/`.
    """

    name: str
    scene: mi.Scene
    own: View
    aspect: float
    views: SceneViews | None = None

    @cached_property
    def placed(self) -> SceneViews:
        """Cameras around the scene, as `gpf scene import` places them."""
        return place_views(self.scene, [self.own], self.aspect)

    @property
    def training_views(self) -> list[View]:
        """Those of `scenes/`; in another scene, its own camera."""
        return list(self.views.train) if self.views else [self.own]

    @property
    def judged_views(self) -> list[View]:
        """The novel views of `scenes/`; in another scene, frames of the path around it."""
        return list(self.views.novel if self.views else self.placed.frames()[3::6])

    @property
    def exposure(self) -> float:
        """The exposure of its images."""
        return (self.views or self.placed).exposure

    def size(self, rows: int) -> tuple[int, int]:
        """Width and height of images with so many rows."""
        return round(rows * self.aspect), rows

    def sensors(self, views: Sequence[View], rows: int) -> list[mi.Sensor]:
        """Sensors with so many rows."""
        return [make_sensor(view, *self.size(rows)) for view in views]

    def fit(
        self, views: Sequence[View] | None = None, rows: int = 256, **goal: Any
    ) -> GaussianPhotonField:
        """A field for views with so many rows, or for cameras that the fit places."""
        sensors = None if views is None else self.sensors(views, rows)
        with progress_bar(f"{self.name}: fit", 1):
            return gpf.fit(self.scene, sensors, **goal)

    def render(
        self,
        field: GaussianPhotonField,
        views: Sequence[View],
        rows: int,
        settings: RenderSettings = RenderSettings(),
    ) -> np.ndarray:
        """Views from a field, (V, H, W, 3)."""
        renderer, size = FieldRenderer.make(self.scene, field, settings), self.size(rows)
        numbered = enumerate(views)
        return np.stack([renderer.render(view, size, seed=k)["radiance"] for k, view in numbered])


def open_scene(name: str) -> MeasuredScene:
    """A built scene or one of `scenes/` by name, or a scene file."""
    if name not in BUILT and not name.endswith(".xml"):
        views = load_views(name)
        with tempfile.TemporaryDirectory() as folder:
            snapshot_scene(name, Path(folder) / name)
            scene = load_scene_file(Path(folder) / name / "scene.xml")
        return MeasuredScene(name, scene, views.train[0], views.aspect, views)
    if name in BUILT:
        built = BUILT[name]()
        scene = built if isinstance(built, mi.Scene) else mi.load_dict(built, optimize=False)
    else:
        file = Path(name)
        scene, name = load_scene_file(file), file.parent.name if file.stem == "scene" else file.stem
    return MeasuredScene(name, scene, views_of_sensors(scene)[0], film_aspect(scene.sensors()[0]))
