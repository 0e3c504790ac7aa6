"""How the frames of an animation are fitted, and in which order.

A frame begins with the Gaussians of the one before it. So a *stretch* of frames without fields is
fitted in order, by one machine. A cluster cuts the frames after the first one into chunks, one for
each machine. The first frame of a chunk begins with the Gaussians of the animation's first frame,
so that all chunks go on from the same Gaussians.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from gpf.core.errors import UserError
from gpf.field.field import GaussianPhotonField
from gpf.fitting.frames import SECONDS, Frame, fit_frames
from gpf.scene.frames import SceneFrame
from gpf.scene.light_groups import LightGroups
from gpf.scene.load import load_frame
from gpf.scene.sensors import make_sensor
from gpf.scene.untraceable import telling_untraceable
from gpf.scene.views import View


@dataclass(frozen=True)
class FrameFit:
    """How frames are fitted; can be sent to a worker.

    Attributes
    ----------
    seconds, passes, seed, groups: as for :func:`gpf.fitting.frames.fit_frames`.
    views: what the fields are for; None to place cameras around the own ones of the frames.
    film: width and height of their images, pixels.
    """

    seconds: float | None
    passes: int | None
    seed: int
    groups: LightGroups | None = None
    views: tuple[View, ...] | None = None
    film: tuple[int, int] = (0, 0)

    def asked(self) -> dict[str, Any]:
        """This as JSON values, for the record of each field."""
        seconds = SECONDS if self.seconds is None and self.passes is None else self.seconds
        views = None
        if self.views is not None:
            views = [self.film, *(view.model_dump(mode="json") for view in self.views)]
        groups = self.groups and [self.groups.names, self.groups.emitters]
        found = {"seconds": seconds, "passes": self.passes, "seed": self.seed}
        text = json.dumps(found | {"groups": groups, "views": views})
        return dict(json.loads(text))  # with lists for tuples, as a file has them

    def fields(
        self, frames: Sequence[SceneFrame], before: Frame | None
    ) -> Iterator[tuple[SceneFrame, GaussianPhotonField]]:
        """Frames and their fields; ``before`` is the frame that the first begins with.

        Raises
        ------
        UserError: as :func:`gpf.fitting.frames.fit_frames`, and names the frame.
        """
        sensors = None
        if self.views is not None:
            sensors = [make_sensor(view, *self.film) for view in self.views]
        fields = fit_frames(
            map(load_frame, frames),
            sensors,
            seconds=self.seconds,
            passes=self.passes,
            seed=self.seed,
            groups=self.groups,
            before=before,
        )
        del before  # or its scene would stay until the last frame
        for frame in frames:
            with _naming(frame):
                field = next(fields)
            field.record["asked"] = self.asked()
            yield frame, field


@contextmanager
def _naming(frame: SceneFrame) -> Iterator[None]:
    """Let errors of users name the frame."""
    try:
        with telling_untraceable(str(frame.file)):
            yield
    except UserError as error:
        if frame.name in error.where:
            raise
        raise UserError(f"{frame.name}: {error.where}", error.what, error.todo) from error


@dataclass(frozen=True)
class Stretch:
    """Frames that follow each other and have no fields.

    Attributes
    ----------
    start, stop: their numbers are from ``start`` to ``stop`` - 1.
    before: the number of the frame that the first begins with, or None.
    """

    start: int
    stop: int
    before: int | None

    def __str__(self) -> str:
        return f"the fit of frames {self.start}:{self.stop}"


def find_stretches(missing: Iterable[int], chunks: Collection[int] = ()) -> list[Stretch]:
    """The stretches of an animation.

    Parameters
    ----------
    missing: the numbers of frames without fields, from 0, in order.
    chunks: the first frames of chunks.
    """
    found: list[Stretch] = []
    for number in missing:
        if found and found[-1].stop == number and number not in chunks:
            found[-1] = replace(found[-1], stop=number + 1)
        else:
            before = None if number == 0 else 0 if number in chunks else number - 1
            found.append(Stretch(number, number + 1, before))
    return found


def cut_chunks(count: int, machines: int) -> set[int]:
    """The first frames of chunks, one for each machine, of all frames but the first."""
    return {1 + k * (count - 1) // machines for k in range(machines)}
