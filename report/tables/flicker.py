"""Table of flicker: how much static diffuse surfaces change in an animation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from report.formats import fixed, join
from report.results import FIELD, Results
from report.table import Column, Row, Table, Value
from report.tables.columns import BEST
from stages.config.titles import method_titles

WAYS = {"directly": "seen directly", "refracted": "through water or glass"}
"""How surfaces are seen: the key in the files of `gpf stage animate`, and its text."""

NOISE = "Noise of the references"


def flicker_table(results: Results) -> Table:
    """A row for each method and columns for each scene of `animation`. Files of other scenes are
    ignored, because no stage keeps them up to date."""
    asked = results.params.animation
    scenes = [s for s in asked.scenes if results.is_current(s)]
    found = {s: results.scene(s).read("flicker.json") for s in scenes}
    found = {scene: file for scene, file in found.items() if file}
    rows = [_row(results, method, found) for method in asked.methods]
    if found:
        rows.append(_noise_row(found))
    return Table(
        name="flicker",
        title="Flicker",
        caption="Change of diffuse surfaces from one frame of the camera path to the next, where "
        "only the camera moves: mean absolute difference in levels of 255, and the share of pixels "
        "in which it is measured. References would flicker with their own noise, so less "
        "flicker than that says nothing. Low flicker does not mean a correct image: an image "
        f"without caustics has no flickering caustics. {BEST}",
        columns=_columns(results, found),
        rows=tuple(rows) if found else (),
        remarks=_remarks(results, found),
    )


def title_of(results: Results, method: str) -> str:
    """A method's title; its name if it is no longer in params.yaml."""
    return method_titles(results.params).get(method, method)


def _columns(results: Results, found: Mapping[str, Any]) -> tuple[Column, ...]:
    columns = []
    for scene, way in _places(found):
        title = f"{results.scene(scene).title}, {WAYS[way]}"
        columns.append(Column(f"{scene}_{way}", title, fixed(2), "lower"))
        columns.append(Column(f"{scene}_{way}_share", "of pixels", "{:.0%}".format))
    return tuple(columns)


def _row(results: Results, method: str, found: Mapping[str, Any]) -> Row:
    numbers = {
        s: file["methods"].get(method, {"cannot_serve": "not run"}) for s, file in found.items()
    }
    reasons = {
        s: known.get("cannot_serve", "no matching surfaces in successive frames")
        for s, known in numbers.items()
    }
    return _make_row(title_of(results, method), numbers, reasons, found, ours=method == FIELD)


def _noise_row(found: Mapping[str, Any]) -> Row:
    """The row of the references' noise, which is not ranked."""
    numbers = {scene: file["noise_of_references"] for scene, file in found.items()}
    reasons = dict.fromkeys(found, "no reference of a novel view has such pixels")
    return _make_row(NOISE, numbers, reasons, found, competes=False)


def _make_row(
    title: str,
    numbers: Mapping[str, Any],
    why: Mapping[str, str],
    found: Mapping[str, Any],
    competes: bool = True,
    ours: bool = False,
) -> Row:
    """A row with the ``numbers`` of each scene, and ``why`` they are missing in a scene."""
    values: dict[str, Value] = {}
    reasons: dict[str, str] = {}
    for scene, way in _places(found):
        key = f"{scene}_{way}"
        if way in numbers[scene]:
            known = numbers[scene][way]
            values |= {key: known["change"], f"{key}_share": known["share"]}
        else:
            reasons |= dict.fromkeys((key, f"{key}_share"), why[scene])
    if not values and len(set(reasons.values())) == 1:
        reasons = {"": next(iter(reasons.values()))}
    return Row(title, values, reasons=reasons, competes=competes, ours=ours)


def _places(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Pairs of a scene and a way in which any method sees surfaces in it."""
    places = []
    for scene, file in found.items():
        seen = [way for way in WAYS if any(way in numbers for numbers in file["methods"].values())]
        places += [(scene, way) for way in seen or WAYS]
    return places


def _remarks(results: Results, found: Mapping[str, Any]) -> tuple[str, ...]:
    waiting = [s for s in results.params.animation.scenes if s not in found]
    titles = join([results.scene(s).title for s in waiting])
    if waiting:
        return (f"Not animated yet: {titles}.",)
    return () if found else ("No scene is animated yet: `animation.scenes` is empty.",)
