"""The table of flicker: numbers of the animations, and reasons for missing numbers."""

from __future__ import annotations

import math

import pytest

from gpf.core.files import write_json
from report.results import Results
from report.tables.flicker import NOISE, flicker_table
from report.writing import to_markdown
from tests.report.made_up import BOX, WATER, made_up_params

GPF, PATH, SPLATS = "GPF, 16 spp", "Path tracer, 50 spp", "3D Gaussian splatting, 3 views"


def told(change: float, share: float) -> dict[str, float]:
    return {"change": change, "share": share, "noise": 0.886 * change}


@pytest.fixture
def results(tmp_path):
    """Water Caustic and the box are animated, the third scene is not; the box has no water."""
    animation = {"scenes": [BOX, WATER, "veach_ajar"], "methods": ["gpf", "path_50", "splatting_3"]}
    files = {
        WATER: {
            "methods": {
                "gpf": {"directly": told(1.54, 0.05), "refracted": told(2.42, 0.67)},
                "path_50": {"directly": told(6.5, 0.05), "refracted": told(16.47, 0.67)},
                "splatting_3": {"cannot_serve": "3 training views are needed"},
            },
            "noise_of_references": {"directly": told(1.0, 0.06), "refracted": told(3.0, 0.7)},
        },
        BOX: {
            "methods": {"gpf": {"directly": told(0.5, 0.9)}, "sppm_3": {"directly": told(9, 0.9)}},
            "noise_of_references": {},
        },
        # Not listed in `animation` any more; its references may have another number of passes.
        "veach_bidir": {"methods": {"gpf": {"directly": told(7, 0.9)}}, "noise_of_references": {}},
    }
    for scene, file in files.items():
        write_json(tmp_path / scene / "flicker.json", file)
    return Results(made_up_params(animation=animation), tmp_path)


def test_rows_are_methods_and_columns_scenes(results):
    table = flicker_table(results)
    frame = table.frame.set_index("method")
    assert list(frame.index) == [GPF, PATH, SPLATS, NOISE]
    ways = (f"{BOX}_directly", f"{WATER}_directly", f"{WATER}_refracted")
    keys = [key for way in ways for key in (way, f"{way}_share")]
    assert [column.key for column in table.columns] == keys
    assert frame.loc[GPF, keys].tolist() == [0.5, 0.9, 1.54, 0.05, 2.42, 0.67]
    titles = [column.title for column in table.columns]
    assert titles[2] == "Water Caustic, seen directly"
    assert titles[4] == "Water Caustic, through water or glass"
    row = next(line for line in to_markdown(table).splitlines() if PATH in line)
    assert "<ins>16.47</ins> | 67%" in " ".join(row.split())


def test_noise_of_references_is_not_ranked(results):
    frame = flicker_table(results).frame.set_index("method")
    noise = frame.loc[NOISE]
    assert noise[f"{WATER}_directly"] == 1 and noise[f"{WATER}_refracted_share"] == 0.7
    # The noise is the smallest number, but it is not ranked.
    ranks = frame[f"{WATER}_directly_rank"]
    assert (ranks[GPF], ranks[PATH]) == (1, 2) and ranks.isna()[NOISE]


def test_missing_numbers_have_reasons(results):
    table = flicker_table(results)
    frame = table.frame.set_index("method")
    assert frame.loc[PATH, "reason"] == "not run"
    assert math.isnan(frame.loc[PATH, f"{BOX}_directly"])
    assert frame.loc[SPLATS, "reason"] == "not run; 3 training views are needed"
    assert "no reference" in frame.loc[NOISE, "reason"]
    assert table.notes[0] == "Not animated yet: Veach Ajar."


def test_without_an_animation_the_table_is_empty_and_says_so(tmp_path):
    table = flicker_table(Results(made_up_params(), tmp_path))
    assert not table.rows and "No scene is animated yet" in table.notes[0]
    asked = Results(made_up_params(animation={"scenes": [BOX]}), tmp_path)
    assert flicker_table(asked).notes == ["Not animated yet: Cornell Box."]
