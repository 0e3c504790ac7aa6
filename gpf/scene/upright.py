"""Which way is up: the vertical of the scene, where cameras only have up vectors that pitch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from gpf.core.vectors import normalise
from gpf.scene.views import Keyframe

AnyCamera = TypeVar("AnyCamera", bound=Keyframe)

# Largest roll about an axis that counts as none, radians: a fiftieth of a pixel.
_LEVEL = 3e-5

# Cameras seldom look up steeply: then the axis counts less.
_LOOKS_UP = 0.4


def upright(cameras: Sequence[AnyCamera]) -> list[AnyCamera]:
    """The cameras of one scene, with the scene's vertical as ``up``; their pictures are the same.

    The vertical is y or z: the axis about which most cameras do not roll. Cameras that do keep
    their own ``up``. One that looks along an axis rolls about neither; then the vertical is the one
    with which it is less steep, and looks down rather than up.
    """
    ahead = normalise(np.array([np.subtract(c.target, c.origin) for c in cameras]).reshape(-1, 3))
    right = normalise(np.cross(ahead, np.array([c.up for c in cameras]).reshape(-1, 3)))
    axes = np.eye(3)[1:]
    upwards = np.cross(right, ahead) @ axes.T  # the cosine of the pitch
    level = np.abs(right @ axes.T) < _LEVEL * upwards
    votes = level * upwards * np.where(ahead @ axes.T > _LEVEL, _LOOKS_UP, 1)
    vertical = int(np.argmax(votes.sum(axis=0)))
    up = tuple(axes[vertical].tolist())
    return [
        camera.model_copy(update={"up": up}) if stands else camera
        for camera, stands in zip(cameras, level[:, vertical], strict=True)
    ]
