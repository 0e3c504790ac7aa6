"""JSON files of stages: what no number in a table could be made from is refused."""

from __future__ import annotations

import json
import math

import pytest

from gpf.core.errors import FileError
from gpf.core.files import read_json
from metrics.files import CostFile, Judged, Point


def part(seconds: float) -> dict[str, float]:
    return {"wall_seconds": seconds, "cpu_seconds": 1.0, "compile_seconds": 0.0}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("shape", "make", "place"),
    [
        (CostFile, lambda x: {"parts": {"a": part(x)}, "facts": {}}, "parts.a.wall_seconds"),
        (CostFile, lambda x: {"parts": {}, "facts": {"path_seconds": x}}, "facts.path_seconds"),
        (list[Point], lambda x: [{"passes": 3, "psnr": x}], "0.psnr"),
        (Judged, lambda x: {"mean": {"psnr": x}, "reasons": {}}, "mean.psnr"),
    ],
)
def test_numbers_are_finite(tmp_path, shape, make, place, value):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(make(2.5)))
    assert read_json(path, shape) == make(2.5)
    path.write_text(json.dumps(make(value)))
    with pytest.raises(FileError, match=rf"has the wrong structure \({place}: .* finite number"):
        read_json(path, shape)


@pytest.mark.parametrize("name", ["wall_seconds", "compile_seconds"])
def test_times_are_not_negative(tmp_path, name):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"parts": {"a": part(2.5) | {name: -1.0}}, "facts": {}}))
    with pytest.raises(FileError, match=rf"parts\.a\.{name}: .* greater than or equal to 0"):
        read_json(path, CostFile)
