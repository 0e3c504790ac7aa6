"""The stages, each with a change of its settings after which it makes other files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import pytest

from tests.stages.conftest import SCENE, Project

FRAMES = 3


@dataclass(frozen=True)
class Case:
    """A stage.

    Attributes
    ----------
    stage: its name.
    change: keys of params.yaml that are set before it runs again.
    folder: one of its output folders, below ``results``.
    options: further options of the command.
    """

    stage: str
    change: Mapping[str, Any]
    folder: str
    options: tuple[str, ...] = field(default=())

    @property
    def arguments(self) -> tuple[str, ...]:
        """Of ``gpf``."""
        scene = () if self.stage == "report" else ("--scene", SCENE)
        return ("stage", self.stage, *scene, *self.options)

    def prepare(self, project: Project) -> None:
        """Change what the stage depends on."""
        if self.stage == "scene":
            project.replace(f"scenes/{SCENE}/scene.xml", "0.105421, 0.37798", "0.2, 0.37798")
            project.replace(f"scenes/{SCENE}/views.yaml", "aspect: 1.25", "aspect: 1.5")
        project.edit("params.yaml", **self.change)


def _of_scene(stage: str, change: dict[str, Any], folder: str, *options: str) -> Case:
    return Case(stage, change, f"{SCENE}/{folder}", options)


CASES = {
    case.stage: case
    for case in (
        _of_scene("scene", {}, "scene"),
        _of_scene("reference", {"reference__seed": 11}, "reference"),
        _of_scene("photons", {"photons__seed": 12}, "costs"),
        _of_scene("train", {"train__seed": 13, "progress__checkpoint_seconds": 1e-6}, "training"),
        _of_scene("render", {"render__seed": 14}, "renders/gpf"),
        _of_scene("baseline", {"render__seed": 14}, "renders/path_10", "--method", "path_10"),
        _of_scene("metrics", {"metrics__relmse_epsilon": 0.02}, "metrics"),
        _of_scene(
            "ablation", {"train__seed": 13}, "ablations/init_radius", "--variant", "init_radius"
        ),
        _of_scene("animate", {"render__seed": 14}, "animation"),
        _of_scene("amortize", {"amortize__views": 50}, "metrics"),
        Case("report", {"amortize__views": 50}, "tables"),
    )
}


STRIDE = 5
"""Of all cases of a test, one in this many is not marked long. The faults meet a few mechanisms
that all stages share, and these cases meet each of them many times. No test has a multiple of five
faults, so that all faults take their turn."""


def in_turn(cases: Iterable[tuple[Any, ...]]) -> list[Any]:
    """Parameters of a test, most of them marked long."""
    return [
        pytest.param(*case, marks=() if number % STRIDE == 0 else pytest.mark.long)
        for number, case in enumerate(cases)
    ]


def stages(*others: Any, turn: int = 0) -> Any:
    """Parametrizes a test with ``stage``, in turn (:func:`in_turn`), from stage number ``turn`` on;
    if there are ``others``, with each of them as ``other``."""
    names = [*CASES][turn:] + [*CASES][:turn]
    if not others:
        return pytest.mark.parametrize("stage", in_turn((name,) for name in names))
    pairs = ((name, other) for name in names for other in others)
    return pytest.mark.parametrize(("stage", "other"), in_turn(pairs))
