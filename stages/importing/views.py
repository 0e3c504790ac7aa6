"""Views of an imported scene: cameras around its own, a path, and an exposure."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi

from gpf.core.images import propose_exposure
from gpf.photons.tracing import PathSettings
from gpf.placement.cameras import place_cameras
from gpf.placement.loops import place_path
from gpf.placement.view_checks import points_seen
from gpf.scene.sensors import make_sensor
from gpf.scene.views import SceneViews, View
from gpf.sppm.passes import PassSettings, propose_radius
from stages.importing.report import PHOTONS
from stages.references.renderer import ReferenceRenderer


def place_views(scene: mi.Scene, own: Sequence[View], aspect: float) -> SceneViews:
    """Training and novel views, a camera path and an exposure; see
    :func:`gpf.placement.cameras.place_cameras`."""
    cameras = place_cameras(scene, own, aspect)
    return SceneViews(
        exposure=measure_exposure(scene, cameras.train[0], aspect),
        aspect=round(aspect, 6),
        fov_axis="x",
        views=cameras,
        path=place_path(scene, own[0], aspect),
    )


def measure_exposure(scene: mi.Scene, view: View, aspect: float, passes: int = 8) -> float:
    """An exposure for a view, from a small image; see :func:`gpf.core.images.propose_exposure`."""
    height = 48
    sensor = make_sensor(view, max(1, round(height * aspect)), height)
    points, _ = points_seen(scene, [view], aspect)
    radius = 2 * propose_radius(scene, points, PathSettings(PHOTONS))
    settings = PassSettings(photons_per_pass=PHOTONS, initial_radius=radius, direct="photons")
    renderer = ReferenceRenderer(scene, {view.name: sensor}, {}, settings, seed=0)
    sums = renderer.run(passes)
    return float(f"{propose_exposure(renderer.image(view.name, sums)):.2g}")
