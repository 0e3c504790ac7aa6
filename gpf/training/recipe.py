"""How a field is made: from photons, targets and settings to a trainer."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.structs import Photons, SurfacePoints, take, to_numpy
from gpf.field.by_detail import field_by_detail
from gpf.field.checks import smallest_search_radius
from gpf.field.field import GaussianPhotonField
from gpf.field.initialization import (
    TYPICAL_SCALE,
    InitialFieldSettings,
    find_gaps,
    initialize_gaussians,
    propose_search_radius,
)
from gpf.guiding.emission_plan import EmissionPlan
from gpf.scene.bounds import scene_bounds
from gpf.scene.lamps import small_lamps
from gpf.scene.light_groups import LightGroups
from gpf.sppm.passes import PassSettings, suit_scene
from gpf.training.detail_choice import choose_detail
from gpf.training.kernel_width import WIDTHS
from gpf.training.settings import TrainingSettings
from gpf.training.streaming import PhotonStream, StreamSettings
from gpf.training.surface_points import share_of_pixels, target_points
from gpf.training.targets import Targets
from gpf.training.trainer import Trainer

MAX_GAUSSIANS = 100_000
"""Largest number that ``gaussians: auto`` tries, as in the paper."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Recipe:
    """The settings with which a field is made from photons and targets."""

    field: InitialFieldSettings = InitialFieldSettings()
    train: TrainingSettings = TrainingSettings()

    @property
    def max_gaussians(self) -> int:
        """Upper limit; with ``auto``, the largest number that the search tries."""
        return MAX_GAUSSIANS if self.field.gaussians == "auto" else self.field.gaussians

    def suit(self, scene: mi.Scene, passes: PassSettings) -> Recipe:
        """The settings for a scene: ``direct: auto`` becomes the list of the small lamps.

        Lamps below the kernel radius of the first pass are small. If photons bring direct light,
        the field stores all of it; or, with ``emitters``, all but what samples of the emitters add
        when a view is rendered.
        """
        by_photons = suit_scene(passes, scene).direct == "photons"
        direct = self.field.direct
        if direct == "auto":
            small = [] if by_photons else small_lamps(scene, passes.initial_radius)
            direct = tuple(small) or "field"
        elif direct == "emitters" and by_photons:
            direct = tuple(range(len(scene.emitters())))
        return replace(self, field=self.field.model_copy(update={"direct": direct}))

    def select_photons(self, photons: Photons) -> Photons:
        """The photons of the light that the field stores: all, or indirect light only.

        Raises
        ------
        UserError: only indirect light is stored, but all photons are direct light.
        """
        if self.field.direct != "emitters":
            return photons
        indirect = dr.compress(photons.depth > 0)
        count = dr.width(indirect)
        if count == 0:
            raise UserError(
                "field.direct: emitters",
                "leaves no light for the field: all photons are direct light",
                "Set field.direct to field.",
            )
        if self.field.gaussians != "auto" and count < self.field.gaussians:
            log.warning(
                "Only %s photons are indirect light, so the field gets that many Gaussians "
                "instead of %s. Trace more photon paths to get more.",
                count,
                self.field.gaussians,
            )
        return take(photons, indirect)

    def supervise(self, targets: Targets) -> SurfacePoints:
        """The points of ``targets`` from which the field learns."""
        return targets.supervised_points(
            self.train.points,
            self.field.stores,
            indirect=self.field.direct == "emitters",
        )

    def initial_field(
        self, count: int, photons: Photons, targets: Targets, bounds: tuple[Any, Any]
    ) -> GaussianPhotonField:
        """The field before training, with ``count`` Gaussians.

        Parameters
        ----------
        photons: the Gaussians start at some of these.
        targets: the field will be trained on these; they show where gaps are.
        bounds: corners of the scene's bounding box.

        Raises
        ------
        UserError: ``field.search_radius`` is too small for a scene of this extent.
        """
        radius, scale = self.field.search_radius, self.field.initial_scale
        if radius == "auto":
            radius = propose_search_radius(photons, count, targets.position, bounds)
        if not (least := smallest_search_radius(bounds)) <= radius:
            raise UserError(
                f"field.search_radius: {radius:.3g}",
                "is too small for the extent of the scene",
                f"Give {least:.2g} or more, or auto.",
            )
        if scale == "auto":
            scale = TYPICAL_SCALE * radius
        decided = {"gaussians": count, "search_radius": radius, "initial_scale": scale}
        initial = self.field.model_copy(update=decided)
        settings, seed = self.field.query(radius), self.train.seed
        gaussians = initialize_gaussians(photons, initial, bounds, seed)
        if self.field.fill_gaps and self.field.initialization == "photons":
            field = GaussianPhotonField(gaussians, settings, bounds)
            gaps = find_gaps(field, targets.position, targets.normal, seed)
            gaussians = initialize_gaussians(photons, initial, bounds, seed, gaps)
        if self.field.stores == "radiance":
            # Photons do not carry the reflectance; the targets of views give its average.
            mean = targets.select("views").reflectance.mean(axis=0) / np.pi
            gaussians.irradiance *= mi.Color3f(*(float(c) for c in mean))
        return GaussianPhotonField(gaussians, settings, bounds)

    def field_by_place(
        self,
        points: SurfacePoints,
        halves: tuple[SurfacePoints, SurfacePoints],
        kernel: float,
        scene: mi.Scene,
    ) -> GaussianPhotonField:
        """The field before training, with as many Gaussians at each place as its light needs.

        Parameters
        ----------
        points: the field will be trained on these.
        halves: the same points, with targets from two independent halves of the photons.
        kernel: radius of the targets' narrowest kernel, world units.
        """
        bounds = scene_bounds(scene)
        detail = choose_detail(points, halves, kernel, bounds)
        settings, at = self.field.query(detail.radius), (to_numpy(points.p), to_numpy(points.n))
        fill = self.field.fill_gaps
        return field_by_detail(scene, detail, settings, bounds, at, self.train.seed, fill)

    def fit_stream(
        self,
        stream: PhotonStream,
        halves: tuple[Targets, Targets],
        photons: Photons,
        bounds: tuple[Any, Any],
    ) -> Trainer:
        """The trainer of a new field, on the targets of all passes so far.

        Parameters
        ----------
        halves: targets from each half of the stream's photons.
        photons: if the number of Gaussians is given, they start at some of these.
        bounds: corners of the scene's bounding box.
        """
        targets = stream.mean(halves)
        points = self.supervise(targets)
        if self.field.gaussians == "auto":
            split = self.supervise(halves[0]), self.supervise(halves[1])
            field = self.field_by_place(points, split, WIDTHS[-1] * stream.radius, stream.scene)
        else:
            photons = self.select_photons(photons)
            field = self.initial_field(self.field.gaussians, photons, targets, bounds)
        return self.trainer(field, points)

    def trainer(
        self,
        field: GaussianPhotonField,
        points: SurfacePoints,
        settings: TrainingSettings | None = None,
    ) -> Trainer:
        """The trainer that fits ``field`` to ``points``, by default with all training steps."""
        return Trainer(
            field,
            points,
            settings or self.train,
            from_targets=self.field.initial_colour == "targets",
            anisotropic=self.field.anisotropic,
        )


def open_stream(
    scene: mi.Scene,
    sensors: Mapping[str, mi.Sensor],
    plan: EmissionPlan,
    passes: PassSettings,
    stream: StreamSettings,
    recipe: Recipe,
    groups: LightGroups | None = None,
) -> tuple[PhotonStream, Photons]:
    """A stream that has no passes yet, and photons for the Gaussians.

    Parameters
    ----------
    sensors: the training views, by name.
    plan: where photons are needed.
    passes: settings of the references' passes; radius and ``alpha`` come from ``stream``.
    recipe: without ``auto`` for direct light (:meth:`Recipe.suit`).
    groups: groups of emitters whose light the stream keeps apart.
    """
    radius = stream.radius * passes.initial_radius
    settings = passes.model_copy(update={"alpha": stream.alpha, "initial_radius": radius})
    pixels = sum(int(np.prod(sensor.film().crop_size())) for sensor in sensors.values())
    wanted = "views" if recipe.field.stores == "radiance" else recipe.train.points
    paths = settings.photons_per_pass
    if recipe.field.gaussians != "auto":
        paths = max(paths, plan.paths_for_gaussians(recipe.field.gaussians))
    photons = plan.collect(scene, paths, stream.seed, settings.rr_depth)
    points = target_points(
        scene,
        {} if wanted == "surface" else sensors,
        plan,
        passes,
        share_of_pixels(stream.view_points, pixels),
        0 if wanted == "views" else stream.surface_points,
        stream.seed,
        photons,
    )
    # With ``emitters``, the recipe subtracts the samples of direct light from the targets.
    direct = recipe.field.direct
    lamps = recipe.field.stored_lamps(scene) if isinstance(direct, tuple) else None
    made = PhotonStream(scene, settings, points, stream.seed, plan.source, lamps, groups)
    return made, photons
