"""Other renderers as baselines: their times, their faults, and when they are missing."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from baselines.available import list_parts
from baselines.cycles import Cycles
from baselines.luxcore.baseline import VARIABLE as LUXCORE
from baselines.options import CyclesOptions
from baselines.peer import PreparedPeer
from baselines.protocol import CannotServe
from gpf.blender import process
from tests.baselines.classical import ABOVE, SIZE, lit_floor, task_for
from tests.furnace import camera


class Renderer:
    """Takes some seconds for each quality, and as many more as it is given."""

    def __init__(self, **seconds: float) -> None:
        self.host, self.started = SimpleNamespace(name="it"), {"version": "1"}
        self.seconds, self.asked, self.value = seconds, [], 0.5

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        self.asked.append(request)
        width, height = request["camera"]["size"]
        np.save(request["image"], np.full((height, width, 3), self.value, np.float32))
        own = self.seconds[request["denoiser"]] + (5 if len(self.asked) == 1 else 0)
        return {"seconds": own + request.get("seconds", 0), "peak_megabytes": 12.0}


def prepared(state: Path, seconds: float, renderer: Renderer) -> PreparedPeer:
    scene = lit_floor(sensor=camera((0, -3, 2), (0, 0, 0)))
    choices = [{"denoiser": quality} for quality in ("accurate", "fast", "none")]
    found = PreparedPeer(task_for(scene, state=state), renderer, seconds, choices)
    found.measure()
    return found


@pytest.mark.parametrize(
    ("seconds", "choice", "left"), [(10, "accurate", 6), (3, "fast", 2), (1.2, "none", 0.7)]
)
def test_a_view_takes_its_time_all_included(tmp_path, seconds, choice, left) -> None:
    renderer = Renderer(accurate=4, fast=1, none=0.5)
    found = prepared(tmp_path, seconds, renderer)
    image = found.render(ABOVE, 7)
    assert image.shape == (*SIZE[::-1], 3) and image.dtype == np.float32
    last = renderer.asked[-1]
    assert last["seconds"] == pytest.approx(left) and last["seed"] == 7
    assert found.facts == {"version": "1", "denoiser": choice, "renderer_megabytes": 12.0}


def test_without_time_for_samples_there_is_no_view(tmp_path) -> None:
    with pytest.raises(CannotServe, match="may take 0.4 s, but one with a single sample"):
        prepared(tmp_path, 0.4, Renderer(accurate=4, fast=1, none=0.5))


def test_images_without_numbers_are_refused(tmp_path) -> None:
    renderer = Renderer(accurate=4, fast=1, none=0.5)
    found = prepared(tmp_path, 10, renderer)
    renderer.value = np.nan
    with pytest.raises(CannotServe, match="it: returned NaN or infinite values"):
        found.render(ABOVE, 1)


def test_without_blender_the_message_names_the_command(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv(process.VARIABLE, str(tmp_path / "nothing"))
    system = Cycles(CyclesOptions(system="cycles"))
    with pytest.raises(CannotServe, match="not installed: Blender.*gpf blender-install"):
        system.prepare(task_for(lit_floor(), state=tmp_path))


def test_the_doctor_lists_renderers_and_how_to_install_them(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv(process.VARIABLE, str(tmp_path / "nothing"))
    monkeypatch.setenv(LUXCORE, str(tmp_path / "nothing"))
    parts = {part.name: part for part in list_parts()}
    assert not parts["cycles"].there and parts["cycles"].remedy == "gpf blender-install"
    assert (
        not parts["luxcore"].there and "pip install --no-deps pyluxcore" in parts["luxcore"].remedy
    )
    monkeypatch.setenv(LUXCORE, sys.executable)
    assert {part.name: part.there for part in list_parts()}["luxcore"]


def test_equal_time_needs_the_fields(tmp_path) -> None:
    system = Cycles(CyclesOptions(system="cycles", seconds="equal_time"))
    with pytest.raises(CannotServe, match="time per view is unknown"):
        system.prepare(task_for(lit_floor(), state=tmp_path))


def test_titles_name_what_is_left_out() -> None:
    titles = [
        CyclesOptions(system="cycles", seconds=60).title,
        CyclesOptions(system="cycles", seconds="equal_time", shadow_caustics=False).title,
    ]
    assert titles == ["Cycles, 60 s", "Cycles, equal time, no shadow caustics"]
