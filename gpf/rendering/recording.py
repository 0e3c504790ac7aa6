"""Recorded frames: kernels are recorded once and launched again without running Python code.

Tracing an integrator that is written in Python takes some milliseconds per frame, more than a third
of the time for a small image. Dr.Jit can record the kernels that a function launches and launch
them again with other arguments. Everything that is not an argument must stay the same.
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
    """A recorded ``render(scene, sensor, seed, spp, arrays)``, and the facts that it depends on.

    The values of arrays may change: those of the scene, of the sensor (a moved camera) and of
    ``arrays``. Objects and plain values may not.
    """

    scene: mi.Scene
    sensor: mi.Sensor
    facts: Hashable
    render: Callable[..., Any]

    def __post_init__(self) -> None:
        self._frozen = dr.freeze(self.render)
        self.frames = 0

    def frame(self, seed: mi.UInt32, spp: int, arrays: Any) -> Any:
        """Render one frame; the first two calls record."""
        # If another scene were garbage-collected during the recording, it would change Dr.Jit's
        # registry, and the process would abort.
        collects = gc.isenabled()
        if not self.frames:
            gc.collect()
        gc.disable()
        self.frames += 1
        try:
            return self._frozen(self.scene, self.sensor, seed, spp, arrays)
        except RuntimeError as error:
            raise RuntimeError(
                "This scene cannot be recorded: one of its plugins, such as an orthographic "
                'camera, does not expose all its data to Dr.Jit. Set "record" to false.'
            ) from error
        finally:
            if collects:
                gc.enable()

    def serves(self, scene: mi.Scene, sensor: mi.Sensor, facts: Hashable) -> bool:
        """Whether the recording was made with these objects and plain values."""
        return self.scene is scene and self.sensor is sensor and self.facts == facts
