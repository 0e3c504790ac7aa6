"""Makes a field from the photons that a stream has so far."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import SurfacePoints, from_numpy, to_numpy
from gpf.field.by_detail import Moves, field_of_frame
from gpf.field.detail import Detail
from gpf.field.field import GaussianPhotonField
from gpf.field.lights import FieldLights
from gpf.field.settings import FieldSettings
from gpf.scene.bounds import scene_bounds
from gpf.scene.light_groups import LightGroups
from gpf.scene.motion import Motion
from gpf.training.detail_choice import choose_detail, field_by_place
from gpf.training.field_error import estimate_error
from gpf.training.half_colours import HalfColours
from gpf.training.light_split import split_light
from gpf.training.settings import LearningRates, TrainingSettings
from gpf.training.shared_detail import keep_shared_detail
from gpf.training.streaming import PhotonStream
from gpf.training.trainer import Trainer
from gpf.training.volume_light import fit_volume

# How far from its surface a Gaussian may lie, in search radii: those on curved ones leave them.
_ABOVE = 0.1


@dataclass(frozen=True)
class Lesson:
    """What a field learns from: every ``stride``-th point, with targets from all photons and from
    two independent halves of them."""

    points: SurfacePoints
    halves: tuple[SurfacePoints, SurfacePoints]
    stride: int


@dataclass(frozen=True)
class FieldMaker:
    """Makes fields from the photons of a stream.

    Attributes
    ----------
    query: the settings of the fields, given their search radius.
    groups: groups of emitters whose light is kept apart.
    training: settings of the training, but for the seed and the number of steps.
    """

    stream: PhotonStream
    query: Callable[[float], FieldSettings]
    groups: LightGroups | None
    training: TrainingSettings

    def supervise(self, stride: int = 1) -> Lesson:
        """What the next field learns from."""
        even, odd = self.stream.halves(stride)
        mean = self.stream.mean((even, odd)).supervised_points()
        return Lesson(mean, (even.supervised_points(), odd.supervised_points()), stride)

    def start(self, lesson: Lesson, steps: int) -> Trainer:
        """The trainer of a new field, for so many steps."""
        stream = self.stream
        place = stream.narrowest, stream.scene, self.query, stream.seed
        field = field_by_place(lesson.points, lesson.halves, *place)
        return Trainer(field, lesson.points, self._settings(steps))

    def go_on(
        self,
        lesson: Lesson,
        steps: int,
        before: GaussianPhotonField,
        earlier: Detail,
        motion: Motion,
    ) -> Trainer:
        """The trainer of a field that begins as that of the frame before, at the usual rates: the
        shapes of its Gaussians are nearly right, and the noise of larger steps would add up from
        frame to frame.

        Parameters
        ----------
        earlier: its levels, on a grid that contains this frame.
        motion: from the frame before to this one.
        """
        scene, bounds = self.stream.scene, scene_bounds(self.stream.scene)
        detail = choose_detail(lesson.points, lesson.halves, self.stream.narrowest, bounds, earlier)
        at = to_numpy(lesson.points.p), to_numpy(lesson.points.n)
        moves = _moves(before, motion)
        query = self.query(detail.radius)  # other lamps may be small in this frame
        field = field_of_frame(scene, before, detail, query, bounds, at, moves, self.stream.seed)
        settings = self._settings(steps).model_copy(update={"rates": LearningRates()})
        return Trainer(field, lesson.points, settings)

    def clean(self, field: GaussianPhotonField, lesson: Lesson, steps: int) -> HalfColours:
        """Remove noise from a field that was trained for so many steps, and add its light in
        media."""
        fitted = HalfColours.fit(field, lesson.halves, self.stream.caustics)
        keep_shared_detail(field, fitted)
        if (volume := self.stream.photons.volume) is not None:
            photons = volume, self.stream.count, lesson.stride
            field.volume = fit_volume(*photons, self.query, self._settings(steps), self.groups)
        return fitted

    def add_error(self, field: GaussianPhotonField, fitted: HalfColours) -> np.ndarray:
        """Give a field its expected relative errors, (N,), as far as two halves of the photons
        tell; returns them."""
        error = estimate_error(field, fitted, self.stream.blur)
        field.set_error(error)
        return error

    def split(self, field: GaussianPhotonField, lesson: Lesson) -> None:
        """Keep the light of the groups apart, if there are any."""
        if self.groups is not None:
            split = split_light(field, lesson.points, self.stream.by_group())
            field.lights = FieldLights(self.groups, split)

    def _settings(self, steps: int) -> TrainingSettings:
        return self.training.model_copy(update={"seed": self.stream.seed, "steps": steps})


def _moves(field: GaussianPhotonField, motion: Motion) -> Moves:
    """How the Gaussians of a field move."""
    assert field.detail is not None
    means = to_numpy(field.gaussians.means)
    reach = _ABOVE * field.detail.radius / np.float32(2) ** field.detail.levels_of(means)
    p, n = from_numpy(mi.Point3f, field.detail.fold(means)), field.gaussians.normals
    there, normals, known = motion.carry(p, n, from_numpy(mi.Float, reach))
    shift = mi.Vector3f(there - p)
    dr.eval(shift, normals, known)
    return Moves(to_numpy(shift), to_numpy(normals), np.array(known))
