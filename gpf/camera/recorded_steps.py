"""Steps of walks through a scene, whose kernels are recorded once and launched again without
running Python.

In a room with 80 materials, tracing the Python code of a camera walk takes a tenth of a second.
Dr.Jit can record the kernels that a function launches, and launch them again with other arguments.
Everything that is not an argument must stay the same, except the parameters of the scene.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.core.errors import is_interrupt
from gpf.scene.lamps import Lamps

log = logging.getLogger(__name__)

MOST_RECORDINGS = 8
"""Recordings of a step to keep: one for each set of samplers, plain values and kinds of arrays."""

Step = Callable[..., Any]
"""Called as ``step(scene, sampler, lamps, *arguments)``, with a list of lamps."""


def traced_step(
    step: Step, scene: mi.Scene, sampler: mi.Sampler, lamps: Sequence[Lamps], *arguments: Any
) -> Any:
    """What a step returns, evaluated with the state of its sampler."""
    found = step(scene, sampler, lamps, *arguments)
    sampler.schedule_state()
    dr.eval(found)
    return found


class RecordedSteps:
    """Steps in one scene, recorded, with the same bits. Those that cannot be recorded are traced
    each time."""

    def __init__(self) -> None:
        self._frozen: dict[Step, Any] = {}  # None: cannot be recorded

    def run(
        self,
        step: Step,
        scene: mi.Scene,
        sampler: mi.Sampler,
        lamps: Sequence[Lamps],
        *arguments: Any,
    ) -> Any:
        """:func:`traced_step`, recorded.

        Parameters
        ----------
        step: a function of a module, without data of its own.
        lamps: that the step samples.
        arguments: evaluated arrays, and plain values.
        """
        # Dr.Jit does not see the plain values of samplers and lamps.
        kind = str(sampler.class_name()), int(sampler.sample_count())
        indices = tuple(None if each.indices is None else tuple(each.indices) for each in lamps)
        arrays = [each.arrays() for each in lamps]
        given = kind, indices, arrays, *arguments
        if step not in self._frozen:
            self._frozen[step] = _rehearsed(step, scene, sampler, *given)
        if (frozen := self._frozen[step]) is None:
            return traced_step(step, scene, sampler, lamps, *arguments)
        with nothing_collected(False):
            return frozen(scene, sampler, *given)


def _rehearsed(step: Step, scene: mi.Scene, sampler: mi.Sampler, *given: Any) -> Any:
    """The recorded step, or None if it cannot be recorded. It is tried with a copy of the sampler:
    an attempt that fails has drawn numbers."""
    frozen = _freeze(step)
    try:
        with nothing_collected(True):
            frozen(scene, sampler.clone(), *given)
    except RuntimeError as error:
        if is_interrupt(error):
            raise
        log.info("Walks cannot be recorded and are traced each time: %s", error)
        return None
    return frozen


def _freeze(step: Step) -> Any:
    def run(
        scene: mi.Scene,
        sampler: mi.Sampler,
        kind: tuple[str, int],
        indices: tuple[tuple[int, ...] | None, ...],
        arrays: list[list[mi.UInt32]],
        *arguments: Any,
    ) -> Any:
        pairs = zip(indices, arrays, strict=True)
        lamps = [Lamps(scene, which).with_arrays(own) for which, own in pairs]
        return traced_step(step, scene, sampler, lamps, *arguments)

    return dr.freeze(run, limit=MOST_RECORDINGS, warn_after=1 << 30)


@contextmanager
def nothing_collected(first: bool) -> Iterator[None]:
    """No garbage collection within the block. If another scene were collected during a recording,
    it would change Dr.Jit's registry, and the process would abort."""
    collects = gc.isenabled()
    if first:
        gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
