"""Table 4 and the table of all costs."""

from __future__ import annotations

from collections.abc import Mapping

from report.formats import join, significant
from report.paper import read_paper
from report.results import FIELD, SECOND_REFERENCE, Results
from report.table import Column, Row, Table
from report.tables.columns import MEMORY, NO_COSTS, PAPER, PREPARATION, SECONDS, STORAGE
from report.tables.quality import scenes_left_out

PATH = "`path` with max_depth 2 at 1 spp"
"""The timing baseline. Times in this unit are roughly comparable between machines."""


def time_table(results: Results) -> Table:
    """Table 4: seconds per image, and the same in units of the timing baseline."""
    scenes = results.scenes
    rows = [
        _row(results, method, title, group)
        for group in ("Seconds per image", f"In units of an image by {PATH}, in the same run")
        for method, title in _methods(results).items()
    ]
    across = tuple(Column(s, results.scene(s).title, significant(3), "lower") for s in scenes)
    return Table(
        name="table_4",
        title="Table 4: time per image",
        caption="Wall-clock time per novel view, without preparation and without compiling "
        f"kernels. {PAPER} A fast method may be far from the reference; see Table 1.",
        columns=across,
        rows=tuple(rows),
        grouped_by="quantity",
        remarks=scenes_left_out(results),
    )


def cost_table(results: Results) -> Table:
    """All costs of all methods, for each scene."""
    times = Column("times_path", "× path", significant(3), "lower")
    columns = (PREPARATION, SECONDS, times, STORAGE, MEMORY)
    rows = []
    for scene in results.scenes:
        for method, title in results.methods_of(scene).items():
            values = results.row(scene, method)
            if ratio := _ratio(values):
                values["times_path"] = ratio
            rows.append(
                Row(
                    title,
                    values,
                    group=results.scene(scene).title,
                    reasons=_reasons(results, scene, method, values),
                    competes=method != SECOND_REFERENCE,
                    ours=method == FIELD,
                )
            )
    return Table(
        name="costs",
        title="What a method costs",
        caption="Preparation is done once per scene. It includes the training data: photons and "
        "targets for the field, targets for the radiance cache, references for systems that learn "
        f"from images. × path: time per view, divided by that of a view by {PATH} in the same run. "
        "Times exclude the compilation of kernels.",
        columns=columns,
        rows=tuple(rows),
        grouped_by="scene",
        remarks=scenes_left_out(results),
    )


def _row(results: Results, method: str, title: str, group: str) -> Row:
    seconds = group.startswith("Seconds")
    paper = read_paper()
    values, reported, reasons = {}, {}, {}
    for scene in results.scenes:
        known = results.row(scene, method)
        value = known.get(SECONDS.key) if seconds else _ratio(known)
        if value is not None:
            values[scene] = value
        elif method not in results.methods_of(scene):
            meant = results.params.baselines[method].scenes
            titles = [results.scene(s).title for s in meant]
            reasons[scene] = f"only for {join(titles)}"
        else:
            found = _reasons(results, scene, method, known)
            reasons[scene] = found.get("") or found[SECONDS.key if seconds else "times_path"]
        time = paper.time(scene, paper.name_of(results.options(method)))
        if seconds and time is not None:
            reported[scene] = time
    if not values and len(set(reasons.values())) == 1:
        reasons = {"": next(iter(reasons.values()))}
    return Row(title, values, reported, group, reasons, method != SECOND_REFERENCE, method == FIELD)


def _methods(results: Results) -> dict[str, str]:
    """Titles of the methods of all scenes; the field and the second reference last."""
    every = {m: t for s in results.scenes for m, t in results.methods_of(s).items()}
    return {m: every[m] for m in sorted(every, key=lambda m: m in (FIELD, SECOND_REFERENCE))}


def _ratio(values: Mapping[str, float]) -> float | None:
    """Seconds per view, in units of the timing baseline of the same run."""
    if "path_seconds" not in values or SECONDS.key not in values:
        return None
    return values[SECONDS.key] / values["path_seconds"]


def _reasons(
    results: Results, scene: str, method: str, values: Mapping[str, float]
) -> dict[str, str]:
    """Why costs are missing."""
    whole = results.reasons(scene, method).get("")
    if whole and SECONDS.key not in values:
        return {"": whole}
    keys = (PREPARATION.key, SECONDS.key, STORAGE.key, MEMORY.key)
    reasons = dict.fromkeys(keys, NO_COSTS)
    reasons["times_path"] = f"the run did not time {PATH}"
    if method == SECOND_REFERENCE:
        reasons |= dict.fromkeys((STORAGE.key, MEMORY.key), "not measured for references")
        reasons[PREPARATION.key] = "SPPM needs none"
        reasons["times_path"] = f"{PATH} is not timed with references"
    return reasons
