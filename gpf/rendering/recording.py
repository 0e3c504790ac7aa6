"""Frames that are recorded once and replayed: a plugin written in Python without Python's cost.

Tracing an integrator that is written in Python takes some milliseconds a frame, more than a third
of the time that a small image takes. Dr.Jit can record what a function launches and launch it again
with other arguments; what a recording has taken for granted has to stay the same, though.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi


@dataclass
class Recording:
    """A recorded ``render(scene, sensor, seed, spp, arrays)`` and what it takes for granted.

    Arrays of the scene, the sensor and ``arrays`` are arguments: their values may change, a moved
    camera included. Objects and plain values are not.
    """

    scene: mi.Scene
    sensor: mi.Sensor
    facts: Hashable
    render: Callable[..., Any]

    def __post_init__(self) -> None:
        self._frozen = dr.freeze(self.render)
        self.frames = 0

    def frame(self, seed: mi.UInt32, spp: int, arrays: Any) -> Any:
        """One frame; the first two calls record."""
        # A scene that happened to be collected as garbage while Dr.Jit records would leave its
        # registry in between, and the process aborts.
        collects = gc.isenabled()
        if not self.frames:
            gc.collect()
        gc.disable()
        self.frames += 1
        try:
            return self._frozen(self.scene, self.sensor, seed, spp, arrays)
        except RuntimeError as error:
            raise RuntimeError(
                "This scene cannot be recorded: one of its plugins (an orthographic camera, to "
                'name one) does not show Dr.Jit all that it holds. Set "record" to false.'
            ) from error
        finally:
            if collects:
                gc.enable()

    def serves(self, scene: mi.Scene, sensor: mi.Sensor, facts: Hashable) -> bool:
        """Whether the recording is one of the same objects and plain values."""
        return self.scene is scene and self.sensor is sensor and self.facts == facts
