"""The views of a scene: the cameras in its ``views.yaml``.

The format, with every key::

    exposure: 2.5            # factor for linear images before they are compared or shown
    aspect: 1.0              # width divided by height of all views
    fov_axis: x              # axis of all fov below, as in Mitsuba: x, y, diagonal, smaller, larger
    views:
      train:                 # training views of the field: at least one
        - {name: front, origin: [0, 0, 3.9], target: [0, 0, 0], up: [0, 1, 0], fov: 39.3}
      novel: []              # views that no method trains on, to compare methods
      more: []               # further training views, for baselines that learn from images
    path:                    # optional: a camera path through keyframes
      frames: 24
      closed: true           # the path continues from the last keyframe to the first
      keyframes:             # at least two
        - {origin: [0, 0, 3.9], target: [0, 0, 0], fov: 39.3}
        - {origin: [1, 0, 3.9], target: [0, 0, 0], fov: 39.3}

Lengths are in scene units, ``fov`` is in degrees, ``up`` is +y by default. A camera whose axis does
not pass through the middle of the image has a ``shift``: ``[0.1, 0]``. Other keys are errors.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from gpf.core.errors import UserError
from gpf.core.settings import Positive, Settings
from gpf.core.yaml import read_yaml, suggest

Finite = Annotated[float, Field(allow_inf_nan=False)]
Aspect = Annotated[float, Field(ge=1e-3, le=1e3, allow_inf_nan=False)]
Shift = Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False)]
Degrees = Annotated[float, Field(gt=0, lt=180)]
Vector = tuple[Finite, Finite, Finite]
FovAxis = Literal["x", "y", "diagonal", "smaller", "larger"]


class Keyframe(Settings):
    """A camera of the path: its position, the point that it looks at, and its angle of view.

    ``shift`` is the principal point's distance from the middle of the image, in widths to the left
    and heights upwards, as Mitsuba's ``principal_point_offset``.
    """

    origin: Vector
    target: Vector
    fov: Degrees
    up: Vector = (0.0, 1.0, 0.0)
    shift: tuple[Shift, Shift] = (0.0, 0.0)

    @model_validator(mode="after")
    def _check_direction(self) -> Keyframe:
        forward = np.subtract(self.target, self.origin)
        if not np.linalg.norm(np.cross(forward, self.up)) > 0:
            raise PydanticCustomError(
                "direction",
                "looks along its own up vector, or nowhere",
                {"todo": "Move the target off the origin and off the line along up."},
            )
        return self


class View(Keyframe):
    """A named camera; ``fov`` is the angle across ``fov_axis``."""

    # Image files are named after the view, with a suffix.
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]*$", max_length=100)]
    fov_axis: FovAxis = "x"

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        if name.startswith("frame_"):
            raise PydanticCustomError(
                "name", "begins with frame_", {"todo": "That is reserved for frames of the path."}
            )
        return name


def name_view(text: str, taken: Collection[str], otherwise: str) -> str:
    """A name for a view from any text, different from the ``taken`` names.

    ``otherwise`` is the name if the text has no letter or digit.
    """
    name = re.sub(r"[^a-z0-9]+", "_", text.lower())[:80].strip("_") or otherwise
    name = f"{otherwise}_{name}" if name.startswith("frame_") else name
    free, number = name, 1
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free


class CameraPath(Settings):
    """Keyframes, and the number of frames on the curve through them."""

    keyframes: Annotated[tuple[Keyframe, ...], Field(min_length=2)]
    frames: Annotated[int, Field(ge=2, le=100_000)] = 24
    closed: bool = False


class ViewSets(Settings):
    """Training views, novel views, and further training views for baselines."""

    train: tuple[View, ...] = ()
    novel: tuple[View, ...] = ()
    more: tuple[View, ...] = ()

    @model_validator(mode="after")
    def _check_names(self) -> ViewSets:
        names = [view.name for view in (*self.train, *self.novel, *self.more)]
        for name in names:
            if names.count(name) > 1:
                raise PydanticCustomError(
                    "duplicate",
                    f"{names.count(name)} views are called {name!r}",
                    {"todo": "Give every view its own name."},
                )
        return self


class SceneViews(Settings):
    """A whole ``views.yaml``. Views without their own ``fov_axis`` use that of the file."""

    views: ViewSets = ViewSets()
    path: CameraPath | None = None
    exposure: Positive = 1.0
    aspect: Aspect = 1.0
    fov_axis: FovAxis = "x"

    @model_validator(mode="after")
    def _check_frames(self) -> SceneViews:
        try:
            self.frames()
        except ValidationError as error:
            first = error.errors()[0]
            where = " ".join(str(part) for part in first["loc"])
            raise PydanticCustomError(
                "path",
                f"leads through impossible cameras: {where} {first['msg']}",
                {"todo": "Add keyframes where the curve overshoots, or move keyframes apart."},
            ) from error
        return self

    @property
    def train(self) -> tuple[View, ...]:
        """The training views."""
        return tuple(self._with_axis(view) for view in self.views.train)

    @property
    def novel(self) -> tuple[View, ...]:
        """The novel views, which no method trains on."""
        return tuple(self._with_axis(view) for view in self.views.novel)

    @property
    def more(self) -> tuple[View, ...]:
        """Further training views, for baselines."""
        return tuple(self._with_axis(view) for view in self.views.more)

    @property
    def given_exposure(self) -> float | None:
        """The exposure, if the file gives one."""
        return self.exposure if "exposure" in self.model_fields_set else None

    def find(self, name: str) -> View:
        """The view or frame with this name; raises a :class:`UserError` if there is none."""
        named = (*self.train, *self.novel, *self.more, *self.frames())
        known = {view.name: view for view in named}
        if name not in known:
            raise UserError(
                f"view {name!r}", "does not exist", suggest(name, list(known), "The views are")
            )
        return known[name]

    def size(self, height: int) -> tuple[int, int]:
        """Width and height of an image with this height, pixels."""
        return max(1, round(height * self.aspect)), height

    def frames(self) -> tuple[View, ...]:
        """The frames of the path as views ``frame_000``, ``frame_001``, …; none without a path.

        Origin, target, up, fov and shift follow uniform Catmull-Rom splines through the keyframes,
        at equal steps of the parameter. An open path ends at its last keyframe. A closed path ends
        one step before its first keyframe, so that it loops without a pause.
        """
        if self.path is None:
            return ()
        keys = np.array(
            [(*k.origin, *k.target, *k.up, k.fov, *k.shift) for k in self.path.keyframes]
        )
        rows = interpolate(keys, self.path.frames, self.path.closed)
        return tuple(
            View(
                name="0",
                origin=row[0:3],
                target=row[3:6],
                up=row[6:9],
                fov=row[9],
                shift=row[10:12],
            ).model_copy(update={"name": f"frame_{i:03d}", "fov_axis": self.fov_axis})
            for i, row in enumerate(rows.tolist())
        )

    def _with_axis(self, view: View) -> View:
        own = "fov_axis" in view.model_fields_set
        return view if own else view.model_copy(update={"fov_axis": self.fov_axis})


def interpolate(keys: np.ndarray, count: int, closed: bool) -> np.ndarray:
    """Catmull-Rom spline through ``keys`` (K, D) at ``count`` evenly spaced parameters: (count, D).

    The tangent at a key is half the difference of its two neighbours; at the ends of an open curve,
    it is the difference of the last two keys.
    """
    from scipy.interpolate import CubicHermiteSpline  # slow: only scenes with a path need it

    n = len(keys)
    if closed:
        t, knots = np.arange(count) * n / count, np.arange(-1, n + 2)
        keys = keys[knots % n]
    else:
        t, knots = np.linspace(0, n - 1, count), np.arange(n)
    spline = CubicHermiteSpline(knots, keys, np.gradient(keys, axis=0))
    return np.asarray(spline(t))


def read_views(file: Path | str, need_training: bool = True) -> SceneViews:
    """Read a ``views.yaml``.

    Raises
    ------
    UserError: as :func:`gpf.core.yaml.read_yaml`, or if ``need_training`` and there is no training
        view.
    """
    found = read_yaml(Path(file), SceneViews, "Write one; gpf/scene/views.py describes the format.")
    if need_training and not found.train:
        raise UserError(
            str(file), "has no training views", "List at least one view under views: train."
        )
    return found
