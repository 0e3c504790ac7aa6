"""Systems compared with the field at equal time and at equal quality."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from report.formats import significant
from report.points import (
    MORE_SAMPLES_HELP,
    REACH,
    Point,
    extrapolate,
    field_point,
    measured_points,
)
from report.results import Results
from report.table import Column, Row, Table, Value
from report.tables.columns import BEST, FLIP, LPIPS, NO_COSTS, PREPARATION, PSNR, RELMSE, SSIM
from report.tables.quality import scenes_left_out

TOLERANCE = 1.05
"""Equal time: at most this multiple of the field's time per view."""

three = significant(3)
TIME = Column("seconds_per_view", "Seconds per view", three)
SETTING = Column("setting", "With")
REACHED = Column("psnr", "PSNR", PSNR.form)
NEEDED = Column("seconds_needed", "Seconds per view", three, "lower")
EXTRAPOLATED = Column("extrapolated_seconds", "Extrapolated, s", lambda s: f"≈ {three(s)}")


def equal_time_table(results: Results) -> Table:
    """The best point of each system that takes no more time per view than the field."""
    rows = []
    for scene, field, systems in _by_scene(results):
        group = results.scene(scene).title
        for system, points in systems.items():
            fits = [p for p in points if p.seconds <= TOLERANCE * field.seconds]
            if fits:
                rows.append(_at_equal_time(max(fits, key=lambda p: p.psnr), group))
            else:
                rows.append(_missing(results, scene, system, points))
        rows.append(_at_equal_time(field, group, ours=True))
    return Table(
        name="equal_time",
        title="At equal time",
        caption="The best measured setting of each system that takes no longer per view than the "
        f"field (or up to {TOLERANCE - 1:.0%} longer), without preparation. Only settings that "
        "were run: a system whose settings are all much faster may be better with more samples. "
        + BEST,
        columns=(TIME, PSNR, SSIM, LPIPS, FLIP, RELMSE, PREPARATION),
        rows=tuple(rows),
        grouped_by="scene",
        remarks=(*scenes_left_out(results), *_without_field(results)),
    )


def equal_quality_table(results: Results) -> Table:
    """The time that each system needs for the field's PSNR."""
    rows = []
    for scene, field, systems in _by_scene(results):
        group = results.scene(scene).title
        for system, points in systems.items():
            if points:
                rows.append(_to_equal_quality(system, points, field, group))
            else:
                rows.append(_missing(results, scene, system, points))
        rows.append(_reached(field, group, ours=True))
    return Table(
        name="equal_quality",
        title="At equal quality",
        caption="Seconds per view that a system needs for the field's PSNR, without preparation: "
        "the time of its fastest setting that reaches it. If none does, the row shows the best "
        "setting that was run, and the longest time. The last column is not measured: for systems "
        "whose error goes to zero with more samples, it is extrapolated from two settings, up to "
        f"{REACH} times the longest time. {BEST}",
        columns=(SETTING, REACHED, NEEDED, EXTRAPOLATED),
        rows=tuple(rows),
        label="system",
        grouped_by="scene",
        remarks=(*scenes_left_out(results), *_without_field(results)),
    )


_TOO_FAR = f"no two settings to extrapolate from, or more than {REACH} times the longest time"


def _at_equal_time(point: Point, group: str, ours: bool = False) -> Row:
    values: dict[str, Value] = {**point.numbers, "seconds_per_view": point.seconds}
    values["prepare_seconds"] = point.prepare_seconds
    reasons = {**point.reasons, PREPARATION.key: NO_COSTS}
    return Row(point.title, values, group=group, reasons=reasons, ours=ours)


def _to_equal_quality(system: str, points: Sequence[Point], field: Point, group: str) -> Row:
    """The row of a system: the fastest setting that is good enough, else the best setting."""
    there = [p for p in points if p.psnr >= field.psnr]
    if there:
        return _reached(there[0], group)
    best = max(points, key=lambda p: p.psnr)
    values: dict[str, Value] = {
        "setting": _setting(best),
        "psnr": best.psnr,
        "seconds_needed": f"not reached in {three(points[-1].seconds)}",
        "extrapolated_seconds": "",
    }
    if system in MORE_SAMPLES_HELP:
        values["extrapolated_seconds"] = extrapolate(points, field.psnr)
    return Row(_name(best), values, group=group, reasons={EXTRAPOLATED.key: _TOO_FAR})


def _reached(point: Point, group: str, ours: bool = False) -> Row:
    """The row of a setting that is good enough; nothing is extrapolated."""
    values: dict[str, Value] = {
        "setting": _setting(point),
        "psnr": point.psnr,
        "seconds_needed": point.seconds,
        "extrapolated_seconds": "",
    }
    return Row(_name(point), values, group=group, ours=ours)


def _missing(results: Results, scene: str, system: str, points: Sequence[Point]) -> Row:
    """The row of a system without a suitable point, with the reason."""
    group = results.scene(scene).title
    if points:
        why = f"its fastest setting takes {three(points[0].seconds)} s per view"
        return Row(_name(points[0]), {}, group=group, reasons={"": why})
    rows, methods = results.params.baselines, results.methods_of(scene)
    own = [m for m in methods if m in rows and rows[m].system == system]
    reasons = {results.reasons(scene, m).get("", NO_COSTS) for m in own}
    label = methods[own[0]].split(",")[0]
    return Row(label, {}, group=group, reasons={"": "; ".join(sorted(reasons))})


def _by_scene(results: Results) -> Iterator[tuple[str, Point, dict[str, list[Point]]]]:
    """Scenes with numbers of the field; for each the field's point and those of all systems."""
    for scene in results.scenes:
        field = field_point(results, scene)
        if field is not None:
            yield scene, field, measured_points(results, scene)


def _without_field(results: Results) -> tuple[str, ...]:
    without = [s for s in results.scenes if field_point(results, s) is None]
    return tuple(
        f"{results.scene(s).title}: the field has no numbers (run `gpf stage render --scene {s}` "
        f"and `gpf stage metrics --scene {s}`)."
        for s in without
    )


def _name(point: Point) -> str:
    """The system in a point's title: the part before the first comma."""
    return point.title.split(",")[0]


def _setting(point: Point) -> str:
    """The settings in a point's title: the part after the first comma."""
    return point.title.removeprefix(_name(point)).removeprefix(", ")
