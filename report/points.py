"""Time and quality as measured: what each system does in how many seconds per view."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from report.results import FIELD, NUMBERS, SECOND_REFERENCE, Results

REACH = 100
"""An extrapolation goes as far as so many times the longest time that was measured."""

MORE_SAMPLES_HELP = ("path_tracer", "particle_tracer", "sppm")
"""Systems whose error goes to zero with time."""


@dataclass(frozen=True)
class Point:
    """A method as it was run.

    Attributes
    ----------
    title: the method, or SPPM with so many passes.
    seconds: per view, without preparation.
    numbers: as far as known, named like :data:`report.results.NUMBERS`; ``psnr`` is.
    prepare_seconds: once per scene; None where that is unknown.
    reasons: why numbers are missing, by their names.
    """

    title: str
    seconds: float
    numbers: Mapping[str, float]
    prepare_seconds: float | None = None
    reasons: Mapping[str, str] = field(default_factory=dict)

    @property
    def psnr(self) -> float:
        """Against the reference, dB."""
        return self.numbers["psnr"]


def measured_points(results: Results, scene: str) -> dict[str, list[Point]]:
    """System -> how it was run, by time. SPPM has points along its convergence, too, of which
    PSNR alone is known and whose time is that of a pass, times their number."""
    rows = results.params.baselines
    systems: dict[str, list[Point]] = {}
    for method, title in results.methods_of(scene).items():
        if method in (FIELD, SECOND_REFERENCE):
            continue
        systems.setdefault(rows[method].system, [])
        if point := _point(results, scene, method, title):
            systems[rows[method].system].append(point)
    files = results.scene(scene)
    if files.seconds_per_pass:
        last = max(files.convergence, default=0)
        for passes, psnr in files.convergence.items():
            title = f"SPPM, {passes} pass{'es' if passes > 1 else ''} as in references"
            known = results.row(scene, SECOND_REFERENCE) if passes == last else {}
            numbers = {key: known[key] for key in NUMBERS if key in known} | {"psnr": psnr}
            reasons = dict.fromkeys(NUMBERS, "of this number of passes, PSNR alone was measured")
            reasons |= results.reasons(scene, SECOND_REFERENCE) if passes == last else {}
            point = Point(title, passes * files.seconds_per_pass, numbers, 0.0, reasons)
            systems.setdefault("sppm", []).append(point)
    return {system: sorted(points, key=lambda p: p.seconds) for system, points in systems.items()}


def field_point(results: Results, scene: str) -> Point | None:
    """The field, if it has been rendered and compared."""
    return _point(results, scene, FIELD, results.methods[FIELD])


def extrapolate(points: Sequence[Point], psnr: float, reach: float = REACH) -> float | None:
    """Seconds that would give ``psnr`` if the last two points went on: log(seconds) is linear in
    PSNR where the error falls as a power of the number of samples. Points that take more than half
    the time of the last are too near to it to tell.

    Nothing if there are no two points of which the slower is the better one, or if it would be
    further than ``reach`` times the last of them.
    """
    earlier = [p for p in points if 2 * p.seconds <= points[-1].seconds]
    if not earlier or points[-1].psnr <= earlier[-1].psnr:
        return None
    before, last = earlier[-1], points[-1]
    slope = math.log(last.seconds / before.seconds) / (last.psnr - before.psnr)
    seconds = last.seconds * math.exp(min((psnr - last.psnr) * slope, 700.0))
    return seconds if seconds <= reach * last.seconds else None


def _point(results: Results, scene: str, method: str, title: str) -> Point | None:
    known = results.row(scene, method)
    if "psnr" not in known or "seconds_per_view" not in known:
        return None
    numbers = {key: known[key] for key in NUMBERS if key in known}
    reasons = results.reasons(scene, method)
    return Point(title, known["seconds_per_view"], numbers, known.get("prepare_seconds"), reasons)
