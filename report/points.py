"""Time and quality of each system: its measured points, and an extrapolation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from report.results import FIELD, NUMBERS, SECOND_REFERENCE, Results

REACH = 100
"""Limit of the extrapolation, as a multiple of the longest measured time."""

MORE_SAMPLES_HELP = ("path_tracer", "particle_tracer", "sppm")
"""Systems whose error goes to zero with more samples."""


@dataclass(frozen=True)
class Point:
    """A measured setting of a system.

    Attributes
    ----------
    title: the method, or SPPM and its number of passes.
    seconds: per view, without preparation.
    numbers: those of :data:`report.results.NUMBERS` that are known; ``psnr`` always is.
    prepare_seconds: once per scene; None if unknown.
    reasons: why numbers are missing, by name.
    """

    title: str
    seconds: float
    numbers: Mapping[str, float]
    prepare_seconds: float | None = None
    reasons: Mapping[str, str] = field(default_factory=dict)

    @property
    def psnr(self) -> float:
        """PSNR against the reference, dB."""
        return self.numbers["psnr"]


def measured_points(results: Results, scene: str) -> dict[str, list[Point]]:
    """System -> its points, sorted by time.

    SPPM also has the points of its convergence curve. Of these only PSNR is known (except for the
    last), and their time is the time of a pass times the number of passes.
    """
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
            reasons = dict.fromkeys(NUMBERS, "only PSNR was measured at this number of passes")
            reasons |= results.reasons(scene, SECOND_REFERENCE) if passes == last else {}
            point = Point(title, passes * files.seconds_per_pass, numbers, 0.0, reasons)
            systems.setdefault("sppm", []).append(point)
    return {system: sorted(points, key=lambda p: p.seconds) for system, points in systems.items()}


def field_point(results: Results, scene: str) -> Point | None:
    """The field's point, if it was rendered and compared."""
    return _point(results, scene, FIELD, results.methods[FIELD])


def extrapolate(points: Sequence[Point], psnr: float, reach: float = REACH) -> float | None:
    """Seconds to reach ``psnr`` (dB), extrapolated from two points.

    log(seconds) is assumed to be linear in PSNR, because the error falls as a power of the number
    of samples. The two points are the last one, and the last one before it that takes at most half
    its time; closer points would give an uncertain slope.

    None if there are no such points, if the slower one is not the better one, or if the result is
    more than ``reach`` times the last time.
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
