"""What the numbers say, in words: the main ones, each scene's, and where the field is not best."""

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
    """A number large enough to be read from afar, and what it means."""

    value: str
    unit: str
    meaning: str
    detail: str


@dataclass(frozen=True)
class Defeat:
    """A number in which other methods are better than the field."""

    number: str
    field: str
    better: list[tuple[str, str]]


@dataclass(frozen=True)
class SceneWords:
    """A scene's figures as text; "" where something has not been measured."""

    psnr: str
    worth: str
    seconds: str
    sppm_seconds: str
    preparation: str
    breaks_even: str
    defeats: list[Defeat]


def main_numbers(results: Results) -> list[MainNumber]:
    """Quality, worth, time and break-even over all scenes that have them."""
    found = [_quality(results), _worth(results), _speed(results), _break_even(results)]
    return [number for number in found if number is not None]


def describe_scene(results: Results, scene: SceneResults) -> SceneWords:
    """One scene."""
    field = results.row(scene.name, FIELD)
    cost = scene.read("amortize.json")
    per_view = cost.get("seconds_per_view", {})
    return SceneWords(
        psnr=f"{field['psnr']:.1f} dB" if "psnr" in field else "",
        worth=_middle(_equivalent_passes(scene)),
        seconds=_seconds(per_view.get(GPF)),
        sppm_seconds=_seconds(per_view.get(SPPM)),
        preparation=_seconds(cost.get("preparation_seconds")),
        breaks_even=_breaks_even(cost),
        defeats=find_defeats(results, scene.name),
    )


def find_defeats(results: Results, scene: str) -> list[Defeat]:
    """Numbers in which another method is better; the second reference competes in none."""
    frame = results.quality
    frame = frame[(frame["scene"] == scene) & (frame["method"] != SECOND_REFERENCE)]
    field = frame[frame["method"] == FIELD]
    defeats = []
    for column in QUALITY:
        key, write, more = column.key, column.form, column.better == "higher"
        if field.empty or pd.isna(field[key].iloc[0]):
            continue
        own = float(field[key].iloc[0])
        won = frame[frame[key] > own] if more else frame[frame[key] < own]
        won = won.sort_values(key, ascending=not more)
        rows = zip(won["title"], won[key], strict=True)
        # What reads the same is no defeat.
        better = [(title, write(value)) for title, value in rows if write(value) != write(own)]
        if better:
            defeats.append(Defeat(column.title, write(own), better))
    return defeats


def tell_victory(results: Results) -> str:
    """What may be said where no other method is better in anything that was compared."""
    compared: list[str] = []
    missing: list[str] = []
    for column in QUALITY:
        known = results.quality.dropna(subset=[column.key])
        others = known[~known["method"].isin([FIELD, SECOND_REFERENCE])]["scene"]
        field = known[known["method"] == FIELD]["scene"]
        both = set(others) & set(field)
        told = both and both >= set(results.scenes)
        (compared if told else missing).append(column.title)
    if not compared:
        return "No number is known of the field and of another method in every scene."
    best = f"in each scene it has the best {join(compared)} of them"
    rest = f" {join(missing)} cannot be told: not every scene has the numbers." if missing else ""
    return f"Nowhere among the methods that were measured: {best}.{rest}"


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
        where = "" if len(scenes) == 1 else " of those measured in all of them"
        detail.append(f"the best other method{where}: {others[best]:.1f} dB")
        detail[-1] += f" ({results.methods[best]})"
    if SECOND_REFERENCE in full:
        detail.append(f"a second reference: {full[SECOND_REFERENCE]:.1f} dB")
    return MainNumber(
        f"{full[FIELD]:.1f}",
        "dB",
        f"PSNR in novel views{_over(len(scenes))}",
        "; ".join(detail),
    )


def _worth(results: Results) -> MainNumber | None:
    values = [w for name in results.scenes for w in _equivalent_passes(results.scene(name))]
    if not values:
        return None
    values.sort(key=_worth_order)
    detail = "in the only novel view"
    if len(values) > 1:
        detail = f"the middle one of {len(values)} novel views: {values[0]} to {values[-1]}"
    return MainNumber(_middle(values), "passes", "of SPPM a view from the field is worth", detail)


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
    across = f"; {least} to {most} times in all scenes" if len(pairs) > 1 else ""
    passes = results.passes
    return MainNumber(
        f"{significant(2)(ratio)}×",
        "",
        f"as fast per view as SPPM with {passes} passes",
        f"{seconds_text(field)} s against {seconds_text(sppm)} s in the middle scene{across}",
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
    passes = results.passes
    never = [results.scene(name).title for name, count in counts.items() if count is None]
    detail = f"photons, targets and training included, against SPPM with {passes} passes"
    detail += f"; never in {join(never)}" if never else ""
    unit = "view" if value == "1" else "views"
    return MainNumber(value, unit, "until all preparation has paid for itself", detail)


def _over(scenes: int) -> str:
    return f", mean of {scenes} scenes" if scenes > 1 else ""


def _equivalent_passes(scene: SceneResults) -> list[str]:
    found = scene.read("metrics", f"{FIELD}.json").get("equivalent_sppm_passes", {})
    return sorted(found.values(), key=_worth_order)


def _worth_order(text: str) -> tuple[float, int]:
    """ "<3" is less than "3", and ">1000" more than "1000"."""
    return float(text.lstrip("<>")), {"<": -1, ">": 1}.get(text[0], 0)


def _middle(values: Sequence[str]) -> str:
    return sorted(values, key=_worth_order)[(len(values) - 1) // 2] if values else ""


def _breaks_even(cost: object) -> str:
    counts = cost.get("break_even_views", {}) if isinstance(cost, dict) else {}
    if SPPM not in counts:
        return ""
    return "never" if counts[SPPM] is None else f"view {counts[SPPM]}"


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{seconds_text(value)} s"
