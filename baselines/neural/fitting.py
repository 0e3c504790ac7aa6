"""Gradient descent on flat parameter arrays: Adam, checkpoints, and recorded functions."""

from __future__ import annotations

import gc
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.files import read_tensors, write_tensors
from gpf.core.structs import from_numpy
from gpf.training.adam import Adam

CHECKPOINT_STEPS = 100
"""Steps between checkpoints."""


@dataclass
class Fit:
    """Parameters under optimisation.

    Attributes
    ----------
    values: the parameters, arrays of any size.
    adam: Adam's moments of the parameters.
    step: number of steps so far.
    """

    values: list[mi.Float]
    adam: Adam = field(default_factory=lambda: Adam([], []))
    step: int = 0

    def __post_init__(self) -> None:
        if not self.adam.first:
            sizes = [dr.width(value) for value in self.values]
            self.adam = Adam(*([dr.opaque(mi.Float, 0, n) for n in sizes] for _ in range(2)))

    def save(
        self,
        path: Path,
        fingerprint: Mapping[str, Any],
        more: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        """Write a checkpoint, atomically; ``more`` holds further arrays of the caller."""
        tensors = dict(more or {})
        groups = ("value", self.values), ("first", self.adam.first), ("second", self.adam.second)
        for name, arrays in groups:
            tensors |= {f"{name}.{k}": array.numpy() for k, array in enumerate(arrays)}
        metadata = {"step": self.step, "fingerprint": dict(fingerprint)}
        write_tensors(path, "baseline checkpoint", tensors, metadata)

    def restore(self, path: Path, fingerprint: Mapping[str, Any]) -> dict[str, np.ndarray] | None:
        """Continue from a checkpoint with the same fingerprint; returns its further arrays.

        Without such a checkpoint, or if it cannot be read, nothing changes and None is returned.
        """
        try:
            tensors, metadata = read_tensors(path, "baseline checkpoint")
        except UserError:
            return None
        if metadata["fingerprint"] != json.loads(json.dumps(dict(fingerprint))):
            return None
        count = len(self.values)
        self.values, first, second = (
            [from_numpy(mi.Float, tensors.pop(f"{name}.{k}")) for k in range(count)]
            for name in ("value", "first", "second")
        )
        self.adam = Adam(first, second)
        self.step = metadata["step"]
        return tensors


def run_steps(
    fit: Fit,
    steps: int,
    step: Callable[[], object],
    save: Callable[[], None],
    report: Callable[[int, int], None],
) -> None:
    """Run the remaining steps up to ``steps``; save every ``CHECKPOINT_STEPS`` and at the end."""
    report(fit.step, steps)
    while fit.step < steps:
        step()
        if fit.step % CHECKPOINT_STEPS == 0 or fit.step == steps:
            save()
        report(fit.step, steps)


def digest(*arrays: np.ndarray) -> str:
    """A short hash of the contents of arrays."""
    total = hashlib.sha256()
    for array in arrays:
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()[:16]


class Model(Protocol):
    """A model whose parameters can be replaced."""

    @property
    def parameters(self) -> list[mi.Float]:
        """The parameters, arrays of any size."""

    def update(self, parameters: list[mi.Float]) -> None:
        """Replace the parameters with others of the same sizes."""


@contextmanager
def given(model: Model, parameters: list[mi.Float]) -> Iterator[None]:
    """Give a model other parameters inside the ``with`` block.

    A recorded function must not replace parameters permanently: the old arrays would be freed while
    Dr.Jit records, which ends the process.
    """
    before = model.parameters
    model.update(parameters)
    try:
        yield
    finally:
        model.update(before)


class Recorded:
    """A function that Dr.Jit records in its first calls and replays later.

    A training step of a network has thousands of operations. Retracing them in Python takes as long
    as the step itself.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._frozen = dr.freeze(function)
        self._calls = 0

    def __call__(self, *arguments: Any) -> Any:
        """Call or replay; arguments are arrays or lists of arrays, of the same sizes each time."""
        collects = gc.isenabled()
        if self._calls == 0:
            gc.collect()
        # If Python collects a scene as garbage while Dr.Jit records, the process ends.
        if self._calls < 2:
            gc.disable()
        self._calls += 1
        try:
            return self._frozen(*arguments)
        finally:
            if collects:
                gc.enable()
