"""Training in a fit: points per second, and seconds to within 0.3 dB of its final error."""

from __future__ import annotations

import time

import gpf
from benchmarks.glass_sphere import load_scene
from benchmarks.timing import Row
from gpf.fitting.fit import FitProgress
from gpf.training.settings import TrainingSettings

PASSES, ROWS = 100, 256


class _Clock:
    """Notes when each step of the last training ended, and the held-out error then."""

    def __init__(self) -> None:
        self.steps: list[tuple[float, int]] = []
        self.errors: list[tuple[float, float]] = []

    def __call__(self, progress: FitProgress) -> None:
        now = time.perf_counter()
        if progress.passes < PASSES or progress.steps == 0:
            return
        if not self.steps or progress.steps > self.steps[-1][1]:
            self.steps.append((now, progress.steps))
        if progress.field is not None and progress.held_out_error is not None:
            self.errors.append((now, progress.held_out_error))


def training_row() -> Row:
    """Seconds, and points per second."""
    scene, clock = load_scene(ROWS, ROWS), _Clock()
    gpf.fit(scene, scene.sensors(), passes=PASSES, callback=clock)
    (begin, first), (end, last) = clock.steps[0], clock.steps[-1]
    rate = (last - first) * TrainingSettings().batch / (end - begin)
    final = clock.errors[-1][1]
    seconds = next(now for now, error in clock.errors if error <= final * 10 ** (0.3 / 20)) - begin
    return Row(
        "training to within 0.3 dB of its final error at held-out points",
        f"{seconds:.1f} s",
        f"{1e-6 * rate:.1f} M points/s",
        "",
        "8 s",
    )
