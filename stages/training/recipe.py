"""How the pipeline makes a field: from photons, targets and settings to a trainer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.progress import say
from gpf.core.structs import Photons, SurfacePoints, take
from gpf.field.checks import smallest_search_radius
from gpf.field.field import GaussianPhotonField
from gpf.field.initialization import TYPICAL_SCALE, find_gaps
from gpf.field.settings import sampled_lamps
from gpf.guiding.emission_plan import EmissionPlan
from gpf.sppm.passes import PassSettings
from gpf.training.detail_choice import field_by_place
from gpf.training.direct_light import choose_direct
from gpf.training.settings import TrainingSettings
from gpf.training.stream_points import stream_points
from gpf.training.streaming import PhotonStream, StreamSettings
from gpf.training.targets import Targets
from gpf.training.trainer import Trainer
from stages.config.training import FieldTrainingSettings, InitialFieldSettings
from stages.training.photon_gaussians import initialize_gaussians, propose_search_radius


@dataclass(frozen=True)
class Recipe:
    """The settings with which a field is made from photons and targets."""

    field: InitialFieldSettings = InitialFieldSettings()
    train: FieldTrainingSettings = FieldTrainingSettings()

    def suit(self, scene: mi.Scene, passes: PassSettings) -> Recipe:
        """The settings for a scene: without ``auto`` for direct light (:func:`choose_direct`)."""
        direct = choose_direct(scene, passes, self.field.direct)
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
            say(
                f"Only {count} photons are indirect light, so the field gets that many Gaussians "
                f"instead of {self.field.gaussians}. Trace more photon paths to get more."
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
            kernel, seed = stream.narrowest, self.train.seed
            settings = self.field.query, seed, self.field.fill_gaps
            field = field_by_place(points, split, kernel, stream.scene, *settings)
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
    settings: StreamSettings,
    recipe: Recipe,
) -> tuple[PhotonStream, Photons]:
    """A stream that has no passes yet, and photons for the Gaussians.

    Parameters
    ----------
    sensors: the training views, by name.
    plan: where photons are needed.
    passes: settings of the references' passes.
    recipe: without ``auto`` for direct light (:meth:`Recipe.suit`).
    """
    paths = settings.passes_like(passes).photons_per_pass
    if recipe.field.gaussians != "auto":
        paths = max(paths, plan.paths_for_gaussians(recipe.field.gaussians))
    photons = plan.collect(scene, paths, settings.seed, passes.rr_depth)
    wanted = "views" if recipe.field.stores == "radiance" else recipe.train.points
    points = stream_points(scene, sensors, plan, passes, settings, photons, wanted)
    # With ``emitters``, the recipe subtracts the samples of direct light from the targets.
    direct = recipe.field.direct
    stored = sampled_lamps(scene, direct).others() if isinstance(direct, tuple) else None
    own = settings.passes_like(passes)
    return PhotonStream(scene, own, points, settings.seed, plan.source, stored), photons
