"""How much the methods of the animation change where only the camera has moved."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gpf.config.titles import method_titles
from report.formats import fixed, join
from report.results import FIELD, Results
from report.table import Column, Row, Table, Value
from report.tables.columns import BEST

WAYS = {"directly": "seen directly", "refracted": "through water or glass"}
"""How surfaces are seen, as `gpf stage animate` names it, and for people."""

NOISE = "Noise of the references alone"


def flicker_table(results: Results) -> Table:
    """Rows methods, columns scenes: those that `animation` asks for. Files of others may be there,
    but no stage keeps them up to date."""
    asked = results.params.animation
    scenes = [s for s in asked.scenes if results.is_as_asked(s)]
    found = {s: results.scene(s).read("animation", "flicker.json") for s in scenes}
    found = {scene: file for scene, file in found.items() if file}
    rows = [_row(results, method, found) for method in asked.methods]
    if found:
        rows.append(_noise_row(found))
    return Table(
        name="flicker",
        title="Flicker",
        caption="What changes from one frame of the camera path to the next where diffuse surfaces "
        "should look the same: mean absolute difference in levels of 255, and the share of all "
        "pixels that it is measured in. References of the path would flicker by their noise; less "
        "than that is no merit. Steady is not right, either: who lacks a caustic has nothing there "
        f"that could flicker. {BEST}",
        columns=_columns(results, found),
        rows=tuple(rows) if found else (),
        remarks=_remarks(results, found),
    )


def title_of(results: Results, method: str) -> str:
    """A method of an animation; one that params.yaml has forgotten has its name alone."""
    return method_titles(results.params).get(method, method)


def _columns(results: Results, found: Mapping[str, Any]) -> tuple[Column, ...]:
    columns = []
    for scene, way in _places(found):
        title = f"{results.scene(scene).title}, {WAYS[way]}"
        columns.append(Column(f"{scene}_{way}", title, fixed(2), "lower"))
        columns.append(Column(f"{scene}_{way}_share", "of pixels", "{:.0%}".format))
    return tuple(columns)


def _row(results: Results, method: str, found: Mapping[str, Any]) -> Row:
    told = {
        s: file["methods"].get(method, {"cannot_serve": "not run"}) for s, file in found.items()
    }
    reasons = {
        s: known.get("cannot_serve", "no surface that is seen so was found again")
        for s, known in told.items()
    }
    return _make_row(title_of(results, method), told, reasons, found, ours=method == FIELD)


def _noise_row(found: Mapping[str, Any]) -> Row:
    """It tells what to expect, and does not compete."""
    told = {scene: file["noise_of_references"] for scene, file in found.items()}
    reasons = dict.fromkeys(found, "no reference of a novel view has such pixels")
    return _make_row(NOISE, told, reasons, found, competes=False)


def _make_row(
    title: str,
    told: Mapping[str, Any],
    why: Mapping[str, str],
    found: Mapping[str, Any],
    competes: bool = True,
    ours: bool = False,
) -> Row:
    """A row of what is ``told`` of each scene, and ``why`` what is missing in it is missing."""
    values: dict[str, Value] = {}
    reasons: dict[str, str] = {}
    for scene, way in _places(found):
        key = f"{scene}_{way}"
        if way in told[scene]:
            known = told[scene][way]
            values |= {key: known["change"], f"{key}_share": known["share"]}
        else:
            reasons |= dict.fromkeys((key, f"{key}_share"), why[scene])
    if not values and len(set(reasons.values())) == 1:
        reasons = {"": next(iter(reasons.values()))}
    return Row(title, values, reasons=reasons, competes=competes, ours=ours)


def _places(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Scenes, and the ways in which any method sees surfaces in them."""
    places = []
    for scene, file in found.items():
        seen = [way for way in WAYS if any(way in told for told in file["methods"].values())]
        places += [(scene, way) for way in seen or WAYS]
    return places


def _remarks(results: Results, found: Mapping[str, Any]) -> tuple[str, ...]:
    waiting = [s for s in results.params.animation.scenes if s not in found]
    titles = join([results.scene(s).title for s in waiting])
    if waiting:
        return (f"Not animated yet: {titles}.",)
    return () if found else ("No scene is animated yet: `animation.scenes` lists none.",)
