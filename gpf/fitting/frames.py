"""``gpf.fit_frames``: a field for each frame of an animation, from a short fit.

A frame takes one field of a fit: no draft, no light gathered by rays, and no estimate of its
quality, each of which takes longer than the photons of a few seconds. All frames have the same
random numbers, the same guided emission and the same kernels, and each begins with the Gaussians of
the one before: on surfaces that move, they move along. So errors change as slowly as the light
does, and what does not move does not flicker.

(Independent photons, and colours averaged with those of the frame before where light has not
changed, flicker up to three times more: fields of so many photons err by the shapes of their
Gaussians and the width of the kernels more than by noise.)
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from gpf.field.field import GaussianPhotonField
from gpf.fitting.field_maker import FieldMaker, Lesson
from gpf.fitting.goals import Goals, TimeBudget, require_seed
from gpf.fitting.opening import Opening, Shared, examine, plan_emission
from gpf.placement.cameras import place_sensors
from gpf.scene.bounds import bounding_box
from gpf.scene.light_groups import LightGroups
from gpf.scene.motion import Motion
from gpf.scene.sensors import views_of_sensors
from gpf.scene.views import View
from gpf.training.detail_choice import MOST_CELLS
from gpf.training.settings import LearningRates, TrainingSettings
from gpf.training.streaming import PhotonStream, StreamSettings
from gpf.training.trainer import Trainer

SECONDS = 10.0
"""Time for a frame, if neither time nor passes are asked for."""

STREAM = StreamSettings(view_points=80_000, surface_points=40_000)
"""A quarter of the points of a fit: in the time that more would take, more photons gain more."""

TRAINING = TrainingSettings(held_out=0, rates=LearningRates(log_scales=6e-2, quats=6e-2))
STEPS = 100
"""A third of a fit's steps. The first frame has three times a fit's rates for the shapes of
Gaussians: as good as twice the steps."""

LEAST_PASSES = 6

LOST = "These shapes have no counterpart in the frame before; their light begins anew: %s."
OUTGROWN = "The scene is much larger than in the frames before; its field begins anew."
GROWN = 4
"""How far the cells of a grid of levels may outnumber those that a fit begins with."""

MOST_NAMES = 5
"""Most names in this message."""

# The part of the first frame's time that is left for all that follows its photons.
_FIRST_ENDING = 0.5


log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Frame:
    """A frame that has its field."""

    scene: mi.Scene
    field: GaussianPhotonField


def fit_frames(
    scenes: Iterable[mi.Scene],
    sensors: Sequence[mi.Sensor] | None = None,
    *,
    seconds: float | None = None,
    passes: int | None = None,
    seed: int = 0,
    groups: LightGroups | None = None,
    before: Frame | None = None,
) -> Iterator[GaussianPhotonField]:
    """Fit a field to each frame of an animation.

    Parameters
    ----------
    scenes: the frames, in order.
    sensors: cameras that see what the fields are for; by default cameras are placed around the own
        ones of a frame, and again where those move.
    seconds: wall-clock time for each frame; by default :data:`SECONDS`.
    passes: photon passes for each frame, at least :data:`LEAST_PASSES`; then the same seed gives
        the same bits on the same machine. Whatever comes first, time or passes, ends a frame.
    seed: of all frames.
    groups: groups of emitters whose light the fields keep apart, the same in all frames: emitters
        are found by their names, and may be missing in some frames.
    before: the frame before the first, which has its field. Cameras are placed in it, unless its
        own ones are elsewhere.

    Raises
    ------
    UserError: a goal or the seed is wrong; or as :func:`gpf.fitting.fit.fit`, when a frame is
        reached.
    """
    require_seed(seed)
    if seconds is None and passes is None:
        seconds = SECONDS
    fitter = _FrameFitter(Goals.asked(seconds, None, passes), sensors, groups, seed, before)
    return map(fitter.fit, scenes)


class _FrameFitter:
    """Fits one frame after the other; parameters as for :func:`fit_frames`."""

    def __init__(
        self,
        goals: Goals,
        sensors: Sequence[mi.Sensor] | None,
        groups: LightGroups | None,
        seed: int,
        before: Frame | None,
    ) -> None:
        self._goals, self._groups = goals, groups
        self._settings = STREAM.model_copy(update={"seed": seed})
        self._sensors, self._places = sensors, sensors is None
        self._own: list[View] = []
        self._before = before
        self._shared: Shared | None = None
        self._ending = _FIRST_ENDING * (goals.seconds or 0)

    def fit(self, scene: mi.Scene) -> GaussianPhotonField:
        """The field of the next frame."""
        origin = examine(scene)
        groups = None if self._groups is None else self._groups.in_frame(scene)
        with TimeBudget(self._goals.seconds) as time:
            shared = self._shared or self._begin_shared()
            look = self._cameras(scene), self._settings, groups, shared
            opening = Opening.look(scene, *look)
            self._shared = opening.shared
            stream = opening.stream
            self._trace(stream, time)
            begin = time.work
            maker = FieldMaker(stream, opening.query, groups, TRAINING)
            lesson = maker.supervise()
            field = self._begin(maker, lesson).run()
            maker.add_error(field, maker.clean(field, lesson, STEPS))
            maker.split(field, lesson)
            self._ending = time.work - begin
            field.record = origin | {
                "passes": stream.count,
                "seconds": time.spent,
                "seed": stream.seed,
                "first_radius": opening.shared.radius,
            }
        dr.flush_malloc_cache()
        self._before = Frame(scene, field)
        return field

    def _begin_shared(self) -> Shared:
        """What all frames have in common, as far as the frame before the first one has it."""
        if self._before is None:
            return Shared()
        scene, field = self._before.scene, self._before.field
        _, plan = plan_emission(scene, self._cameras(scene), self._settings.seed)
        return Shared(field.record.get("first_radius", "auto"), plan)

    def _begin(self, maker: FieldMaker, lesson: Lesson) -> Trainer:
        """The trainer of the next frame's field."""
        scene = maker.stream.scene
        if self._before is None or (earlier := self._before.field.detail) is None:
            return maker.start(lesson, STEPS)
        lower, upper = bounding_box(scene)
        detail = earlier.around(lower, upper, GROWN * MOST_CELLS)
        if detail is None:
            log.warning(OUTGROWN)
            return maker.start(lesson, STEPS)
        motion = Motion(self._before.scene, scene)
        if motion.lost:
            log.warning(LOST, ", ".join(motion.lost[:MOST_NAMES]))
        return maker.go_on(lesson, STEPS, self._before.field, detail, motion)

    def _trace(self, stream: PhotonStream, time: TimeBudget) -> None:
        """Trace photons until the passes are done, or until what follows needs the time left."""
        while stream.count < LEAST_PASSES or (
            stream.count < self._goals.passes
            and not time.is_over(self._ending + time.pass_seconds / 2)
        ):
            time.start_pass()
            stream.advance(stream.count + 1)
            time.note_pass()
        stream.sample()

    def _cameras(self, scene: mi.Scene) -> Sequence[mi.Sensor]:
        """The cameras that see what the field of a frame is for."""
        if not self._places:
            return sorted(self._sensors or (), key=str)  # as for a single field
        own, before = views_of_sensors(scene), self._before
        if self._sensors is None or own != self._own:
            if before is not None and views_of_sensors(before.scene) == own:
                # All that goes on from one frame has the same cameras.
                scene = before.scene
            self._sensors, self._own = place_sensors(scene), own
        return self._sensors
