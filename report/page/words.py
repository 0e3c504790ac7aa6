"""Texts with numbers: the main numbers, those of each scene, and where the field is not best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from metrics.cost import GPF, SPPM
from report.formats import join, significant
from report.results import FIELD, SECOND_REFERENCE, Results, SceneResults
from report.tables.columns import QUALITY

seconds_text = significant(2)


@dataclass(frozen=True)
class MainNumber:
    """A number in large type, and its explanation."""

    value: str
    unit: str
    meaning: str
    detail: str


@dataclass(frozen=True)
class WorseMetric:
    """A metric in which other methods are better; ``better`` has their titles and values."""

    number: str
    field: str
    better: list[tuple[str, str]]


@dataclass(frozen=True)
class SceneWords:
    """A scene's numbers as text; "" for a number that was not measured."""

    psnr: str
    equivalent_passes: str
    seconds: str
    sppm_seconds: str
    preparation: str
    breaks_even: str
    worse_metrics: list[WorseMetric]


def main_numbers(results: Results) -> list[MainNumber]:
    """PSNR, equivalent passes, speed and break-even over all scenes that have them."""
    found = [_quality(results), _equivalent(results), _speed(results), _break_even(results)]
    return [number for number in found if number is not None]


def describe_scene(results: Results, scene: SceneResults) -> SceneWords:
    """The texts of a scene."""
    field = results.row(scene.name, FIELD)
    cost = scene.read("amortize.json")
    per_view = cost.get("seconds_per_view", {})
    return SceneWords(
        psnr=f"{field['psnr']:.1f} dB" if "psnr" in field else "",
        equivalent_passes=_median(_equivalent_passes(scene)),
        seconds=_seconds(per_view.get(GPF)),
        sppm_seconds=_seconds(per_view.get(SPPM)),
        preparation=_seconds(cost.get("preparation_seconds")),
        breaks_even=_breaks_even(cost),
        worse_metrics=find_worse_metrics(results, scene.name),
    )


def find_worse_metrics(results: Results, scene: str) -> list[WorseMetric]:
    """Metrics in which another method is better; the second reference is not compared."""
    frame = results.quality
    frame = frame[(frame["scene"] == scene) & (frame["method"] != SECOND_REFERENCE)]
    field = frame[frame["method"] == FIELD]
    worse = []
    for column in QUALITY:
        key, write, more = column.key, column.form, column.better == "higher"
        if field.empty or pd.isna(field[key].iloc[0]):
            continue
        own = float(field[key].iloc[0])
        won = frame[frame[key] > own] if more else frame[frame[key] < own]
        won = won.sort_values(key, ascending=not more)
        rows = zip(won["title"], won[key], strict=True)
        # A number with the same text is not better.
        better = [(title, write(value)) for title, value in rows if write(value) != write(own)]
        if better:
            worse.append(WorseMetric(column.title, write(own), better))
    return worse


def describe_best(results: Results) -> str:
    """The text if no other method is better: names the metrics that all scenes have."""
    compared: list[str] = []
    missing: list[str] = []
    for column in QUALITY:
        known = results.quality.dropna(subset=[column.key])
        others = known[~known["method"].isin([FIELD, SECOND_REFERENCE])]["scene"]
        field = known[known["method"] == FIELD]["scene"]
        both = set(others) & set(field)
        in_all = both and both >= set(results.scenes)
        (compared if in_all else missing).append(column.title)
    if not compared:
        return "No metric is known for the field and another method in every scene."
    best = f"in each scene the field has the best {join(compared)} of all measured methods"
    rest = f" {join(missing)}: not every scene has the numbers." if missing else ""
    return f"Nowhere: {best}.{rest}"


def _quality(results: Results) -> MainNumber | None:
    frame = results.quality.dropna(subset=["psnr"])
    scenes = frame[frame["method"] == FIELD]["scene"].tolist()
    if not scenes:
        return None
    means = frame[frame["scene"].isin(scenes)].groupby("method")["psnr"].agg(["mean", "count"])
    full = means[means["count"] == len(scenes)]["mean"]
    others = full.drop([FIELD, SECOND_REFERENCE], errors="ignore")
    detail = []
    if not others.empty:
        best = str(others.idxmax())
        where = "" if len(scenes) == 1 else " with numbers in all scenes"
        detail.append(f"the best other method{where}: {others[best]:.1f} dB")
        detail[-1] += f" ({results.methods[best]})"
    if SECOND_REFERENCE in full:
        detail.append(f"the second reference: {full[SECOND_REFERENCE]:.1f} dB")
    return MainNumber(
        f"{full[FIELD]:.1f}",
        "dB",
        f"PSNR in novel views{_over(len(scenes))}",
        "; ".join(detail),
    )


def _equivalent(results: Results) -> MainNumber | None:
    values = [n for name in results.scenes for n in _equivalent_passes(results.scene(name))]
    if not values:
        return None
    values.sort(key=_passes_order)
    detail = "in the only novel view"
    if len(values) > 1:
        detail = f"median of {len(values)} novel views ({values[0]} to {values[-1]})"
    return MainNumber(_median(values), "passes", "of SPPM give the same PSNR as the field", detail)


def _speed(results: Results) -> MainNumber | None:
    pairs = []
    for name in results.scenes:
        seconds = results.scene(name).read("amortize.json").get("seconds_per_view", {})
        if seconds.get(GPF) and seconds.get(SPPM):
            pairs.append((seconds[SPPM] / seconds[GPF], seconds[GPF], seconds[SPPM]))
    if not pairs:
        return None
    ratio, field, sppm = sorted(pairs)[(len(pairs) - 1) // 2]
    least, most = (f"{significant(2)(r)}" for r in (min(pairs)[0], max(pairs)[0]))
    across = f"; {least} to {most} times over all scenes" if len(pairs) > 1 else ""
    scene = " in the median scene" if len(pairs) > 1 else ""
    return MainNumber(
        f"{significant(2)(ratio)}×",
        "",
        f"as fast per view as SPPM with {results.passes} passes",
        f"{seconds_text(field)} s against {seconds_text(sppm)} s{scene}{across}",
    )


def _break_even(results: Results) -> MainNumber | None:
    counts = {}
    for name in results.scenes:
        cost = results.scene(name).read("amortize.json")
        if "break_even_views" in cost:
            counts[name] = cost["break_even_views"][SPPM]
    known = sorted(count for count in counts.values() if count is not None)
    if not known:
        return None
    value = str(known[0]) if known[0] == known[-1] else f"{known[0]}–{known[-1]}"
    never = [results.scene(name).title for name, count in counts.items() if count is None]
    detail = f"photons, targets and training included, against SPPM with {results.passes} passes"
    detail += f"; never in {join(never)}" if never else ""
    unit = "view" if value == "1" else "views"
    return MainNumber(value, unit, "until the preparation pays off", detail)


def _over(scenes: int) -> str:
    return f", mean of {scenes} scenes" if scenes > 1 else ""


def _equivalent_passes(scene: SceneResults) -> list[str]:
    found = scene.read("metrics", f"{FIELD}.json").get("equivalent_sppm_passes", {})
    return list(found.values())


def _passes_order(text: str) -> tuple[float, int]:
    """Sort key: "<3" comes before "3", and ">1000" after "1000"."""
    return float(text.lstrip("<>")), {"<": -1, ">": 1}.get(text[0], 0)


def _median(values: Sequence[str]) -> str:
    """The median number of passes, the lower one of two; "" without values."""
    return sorted(values, key=_passes_order)[(len(values) - 1) // 2] if values else ""


def _breaks_even(cost: object) -> str:
    counts = cost.get("break_even_views", {}) if isinstance(cost, dict) else {}
    if SPPM not in counts:
        return ""
    return "never" if counts[SPPM] is None else f"view {counts[SPPM]}"


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{seconds_text(value)} s"
