"""Tables 1 and 2: metrics of all systems against the references."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean

from report.formats import join
from report.paper import read_paper
from report.results import FIELD, SECOND_REFERENCE, Results
from report.table import Column, Row, Table, Value
from report.tables.columns import (
    BEST,
    NO_COSTS,
    PAPER,
    PREPARATION,
    PSNR,
    QUALITY,
    SECONDS,
    STORAGE,
)

LEARN_FROM_IMAGES = ("instant_ngp", "splatting", "anysplat")
"""Systems of Table 2."""


def glance_table(results: Results) -> Table:
    """PSNR: a row for each method, a column for each scene."""
    paper, scenes = read_paper(), results.scenes
    names = {m: paper.name_of(results.options(m)) for m in _methods_of_all(results)}
    methods = _methods_of_all(results)
    rows = []
    for method, title in methods.items():
        values: dict[str, Value] = {s: results.row(s, method).get("psnr") for s in scenes}
        reported = {s: paper.quality(s, names[method]).get("psnr") for s in scenes}
        mean = mean_row(results, method, title)
        values["mean"], reported["mean"] = mean.values.get("psnr"), mean.paper.get("psnr")
        reasons = {s: r[""] for s in scenes if (r := results.reasons(s, method)) and "" in r}
        if why := mean.reasons.get("psnr", mean.reasons.get("")):
            reasons["mean"] = why
        if len(set(reasons.values())) == 1 and len(reasons) == len(values):
            reasons = {"": reasons["mean"]}
        known = {key: value for key, value in reported.items() if value is not None}
        rows.append(_row(method, title, values, known, "", reasons))
    titles = {scene: results.scene(scene).title for scene in scenes}
    across = [Column(key, title, PSNR.form, "higher") for key, title in titles.items()]
    return Table(
        name="table_1_psnr",
        title="Table 1 at a glance: PSNR",
        caption=f"PSNR of novel views, dB; higher is better. {_how_to_read(results)}",
        columns=(*across, Column("mean", "Mean", PSNR.form, "higher")),
        rows=tuple(rows),
        remarks=_remarks(results),
    )


def systems_table(results: Results) -> Table:
    """Table 1: all systems in all scenes, and their means."""
    rows = [
        quality_row(results, scene, method, title)
        for scene in results.scenes
        for method, title in results.methods_of(scene).items()
    ]
    rows += [mean_row(results, m, title) for m, title in _methods_of_all(results).items()]
    return Table(
        name="table_1",
        title="Table 1: all systems",
        caption=f"Novel views against references of {results.passes} SPPM passes. "
        f"{_how_to_read(results)} Methods that store nothing are not ranked by storage.",
        columns=(*QUALITY, STORAGE),
        rows=tuple(rows),
        grouped_by="scene",
        remarks=_remarks(results),
    )


def learned_table(results: Results) -> Table:
    """Table 2: systems that learn a scene from images."""
    options = results.params.baselines
    learned = [m for m, row in options.items() if row.system in LEARN_FROM_IMAGES]
    seen = " or ".join(str(n) for n in sorted({options[m].training_views for m in learned}))
    rows: list[Row] = []
    for scene in results.scenes:
        methods = results.methods_of(scene)
        if any(method in methods for method in learned):
            shown = [*(m for m in methods if m in learned), FIELD]
            rows += [quality_row(results, scene, m, methods[m]) for m in shown]
    return Table(
        name="table_2",
        title="Table 2: systems that learn from images",
        caption=f"Novel views of systems that learn from references of {seen or 'some'} training "
        f"views, in the scenes that `baselines` in params.yaml lists for them. {PAPER} {BEST}",
        columns=(*QUALITY, STORAGE, PREPARATION, SECONDS),
        rows=tuple(rows),
        grouped_by="scene",
        remarks=scenes_left_out(results) if rows else _no_learned(results),
    )


def _no_learned(results: Results) -> tuple[str, ...]:
    """Remarks that say why Table 2 is empty."""
    measured = "`baselines` has no such system for any measured scene."
    return (*scenes_left_out(results), *((measured,) if results.scenes else ()))


def quality_row(results: Results, scene: str, method: str, title: str) -> Row:
    """The row of a method in a scene."""
    values, reasons = results.row(scene, method), results.reasons(scene, method)
    if "" not in reasons:
        reasons |= {key: why for key, why in _unmeasured_costs(method).items() if key not in values}
    paper = read_paper()
    reported = paper.quality(scene, paper.name_of(results.options(method)))
    return _row(method, title, values, reported, results.scene(scene).title, reasons)


def mean_row(results: Results, method: str, title: str) -> Row:
    """A method's means over all measured scenes; only numbers that all these scenes have."""
    scenes = results.scenes
    found = {scene: results.row(scene, method) for scene in scenes}
    values, reasons = {}, {}
    for column in (*QUALITY, STORAGE):
        without = [s for s in scenes if column.key not in found[s]]
        if scenes and not without:
            values[column.key] = fmean(row[column.key] for row in found.values())
        else:
            reasons[column.key] = _why_no_mean(results, method, without, column.key)
    if not values and len(set(reasons.values())) == 1:
        reasons = {"": next(iter(reasons.values()))}
    paper = read_paper()
    reported = paper.mean_over(scenes, paper.name_of(results.options(method)))
    group = f"Mean over {len(scenes)} scene{'s' if len(scenes) != 1 else ''}"
    return _row(method, title, values, reported, group, reasons)


def scenes_left_out(results: Results) -> tuple[str, ...]:
    """Remarks about scenes without numbers, or with references of a different number of passes."""
    remarks = []
    without = [s for s in results.unmeasured if not results.has_metrics(s)]
    others = [s for s in results.unmeasured if results.has_metrics(s)]
    if without:
        remarks.append(f"Not measured yet: {join([results.scene(s).title for s in without])}.")
    if others:
        titles = join([results.scene(s).title for s in others])
        remarks.append(f"Not measured yet against {results.passes} passes of SPPM: {titles}.")
    return tuple(remarks)


def _remarks(results: Results) -> tuple[str, ...]:
    """Remarks about the means, and about methods that have no row."""
    fewer = set(results.scenes) < set(read_paper().systems)
    means = ("In the means, the paper's numbers cover the same scenes as ours.",) if fewer else ()
    some = {m for scene in results.scenes for m in results.methods_of(scene)}
    nowhere = [title for m, title in results.methods.items() if m not in some]
    where = f"Only for other scenes, according to `baselines`: {join(nowhere)}."
    elsewhere = (where,) if nowhere and results.scenes else ()
    return (*scenes_left_out(results), *means, *elsewhere)


def _row(
    method: str,
    title: str,
    values: Mapping[str, Value],
    paper: Mapping[str, float],
    group: str,
    reasons: Mapping[str, str],
) -> Row:
    ours, competes = method == FIELD, method != SECOND_REFERENCE
    return Row(title, values, paper, group, reasons, competes, ours)


def _methods_of_all(results: Results) -> dict[str, str]:
    """Titles of the methods that are for all scenes."""
    rows = results.params.baselines
    every = {m: t for s in results.scenes for m, t in results.methods_of(s).items()}
    return {m: t for m, t in every.items() if m not in rows or not rows[m].scenes}


def _why_no_mean(results: Results, method: str, without: Sequence[str], key: str) -> str:
    """The reason if it is the same in all scenes, else the scenes without a number."""
    found = [results.reasons(scene, method) for scene in without]
    reasons = {r.get("", r.get(key)) for r in found}
    if len(without) == len(results.scenes) and len(reasons) == 1 and (why := reasons.pop()):
        return why
    if len(without) == len(results.scenes):
        has_images = any("" not in r for r in found)
        nothing = "no numbers in any scene"
        return _unmeasured_costs(method).get(key, nothing) if has_images else nothing
    return f"no number in {join([results.scene(s).title for s in without])}"


def _unmeasured_costs(method: str) -> dict[str, str]:
    """Why a method with images has no costs."""
    if method == SECOND_REFERENCE:
        return {STORAGE.key: "only the images of references are stored"}
    return dict.fromkeys((STORAGE.key, PREPARATION.key, SECONDS.key), NO_COSTS)


def _how_to_read(results: Results) -> str:
    second = results.methods[SECOND_REFERENCE]
    apart = f"{second}: the second reference; it shows how well references agree; not ranked."
    return f"{PAPER} {BEST} {apart}"
