"""The views of a scene: cameras as a ``views.yaml`` describes them.

The format, with every key::

    exposure: 2.5            # linear images are multiplied by it before they are compared or shown
    aspect: 1.0              # width over height of every view
    fov_axis: x              # what every fov below refers to; that of the scene's own sensor
    views:
      train:                 # what a field is fitted to: at least one
        - {name: front, origin: [0, 0, 3.9], target: [0, 0, 0], up: [0, 1, 0], fov: 39.3}
      novel: []              # what it is judged by: views that no training saw
      more: []               # for systems that learn from pictures: more than the field's three
    path:                    # optional: a camera path, through keyframes
      frames: 24
      closed: true           # the last keyframe leads back to the first
      keyframes:
        - {origin: [0, 0, 3.9], target: [0, 0, 0], fov: 39.3}

Lengths are scene units, ``fov`` is in degrees, ``up`` defaults to +y. Other keys are errors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from gpf.core.errors import UserError
from gpf.core.yaml import read_yaml, suggest

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Degrees = Annotated[float, Field(gt=0, lt=180)]
Vector = tuple[Finite, Finite, Finite]
FovAxis = Literal["x", "y", "diagonal", "smaller", "larger"]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Keyframe(_Model):
    """One camera of a path: where it stands, what it looks at, and how wide."""

    origin: Vector
    target: Vector
    fov: Degrees
    up: Vector = (0.0, 1.0, 0.0)

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
    """A named camera. ``fov`` is the angle across ``fov_axis``."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]*$")]
    fov_axis: FovAxis = "x"

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        if name.startswith("frame_"):
            raise PydanticCustomError(
                "name", "begins with frame_", {"todo": "Frames of the path are called so."}
            )
        return name


class CameraPath(_Model):
    """Keyframes, and how many frames to spread evenly over the curve through them."""

    keyframes: Annotated[tuple[Keyframe, ...], Field(min_length=2)]
    frames: Annotated[int, Field(ge=2)] = 24
    closed: bool = False


class ViewSets(_Model):
    """The views that a field is fitted to, those that it is judged by, and further ones to train
    systems with that need more."""

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
                    {"todo": "Give every view a name of its own."},
                )
        return self


class SceneViews(_Model):
    """A whole ``views.yaml``. Views take over ``fov_axis`` unless they have their own."""

    views: ViewSets = ViewSets()
    path: CameraPath | None = None
    exposure: Positive = 1.0
    aspect: Positive = 1.0
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
                f"leads through cameras that cannot be: {where} {first['msg']}",
                {"todo": "Add keyframes where it swings too far, or move them apart."},
            ) from error
        return self

    @property
    def train(self) -> tuple[View, ...]:
        """The training views."""
        return tuple(self._with_axis(view) for view in self.views.train)

    @property
    def novel(self) -> tuple[View, ...]:
        """The views that no training sees."""
        return tuple(self._with_axis(view) for view in self.views.novel)

    @property
    def more(self) -> tuple[View, ...]:
        """Further views to train with."""
        return tuple(self._with_axis(view) for view in self.views.more)

    def find(self, name: str) -> View:
        """The view or the frame of this name."""
        named = (*self.train, *self.novel, *self.more, *self.frames())
        known = {view.name: view for view in named}
        if name not in known:
            raise UserError(
                f"view {name!r}", "does not exist", suggest(name, list(known), "The views are")
            )
        return known[name]

    def size(self, height: int) -> tuple[int, int]:
        """Width and height in pixels of an image of this many rows."""
        return max(1, round(height * self.aspect)), height

    def frames(self) -> tuple[View, ...]:
        """The frames of the path as views ``frame_000``, ``frame_001``, …; none without a path.

        Origin, target, up and fov follow uniform Catmull-Rom splines through the keyframes, at
        equal steps of the spline's parameter. An open path ends on its last keyframe; a closed
        one stops a step before its first, so that it repeats without a pause.
        """
        if self.path is None:
            return ()
        keys = np.array([(*k.origin, *k.target, *k.up, k.fov) for k in self.path.keyframes])
        rows = interpolate(keys, self.path.frames, self.path.closed)
        return tuple(
            View(name="0", origin=row[0:3], target=row[3:6], up=row[6:9], fov=row[9]).model_copy(
                update={"name": f"frame_{i:03d}", "fov_axis": self.fov_axis}
            )
            for i, row in enumerate(rows.tolist())
        )

    def _with_axis(self, view: View) -> View:
        own = "fov_axis" in view.model_fields_set
        return view if own else view.model_copy(update={"fov_axis": self.fov_axis})


def interpolate(keys: np.ndarray, count: int, closed: bool) -> np.ndarray:
    """Catmull-Rom spline through ``keys`` (K, D) at ``count`` even parameters: (count, D).

    Between keys b and c, with neighbours a and d and parameter s in [0, 1]::

        ½ [2b + (c - a) s + (2a - 5b + 4c - d) s² + (3b - a - 3c + d) s³]

    The ends of an open curve are continued by reflection: a = 2b - c.
    """
    n = len(keys)
    if closed:
        padded = np.concatenate([keys[-1:], keys, keys[:2]])
        t = np.arange(count) * n / count
    else:
        padded = np.concatenate([2 * keys[:1] - keys[1:2], keys, 2 * keys[-1:] - keys[-2:-1]])
        t = np.linspace(0, n - 1, count)
    first = np.minimum(t.astype(int), n - (1 if closed else 2))
    s = (t - first)[:, None]
    a, b, c, d = (padded[first + i] for i in range(4))
    return 0.5 * (
        2 * b + (c - a) * s + (2 * a - 5 * b + 4 * c - d) * s**2 + (3 * b - a - 3 * c + d) * s**3
    )


def read_views(file: Path, need_training: bool = True) -> SceneViews:
    """Read a ``views.yaml``.

    Raises
    ------
    UserError: what :func:`gpf.core.yaml.read_yaml` objects to, or, where ``need_training``, that
        there is no training view.
    """
    found = read_yaml(file, SceneViews, "Write one; gpf/scene/views.py describes the format.")
    if need_training and not found.train:
        raise UserError(
            str(file), "has no training views", "List at least one view under views: train."
        )
    return found
