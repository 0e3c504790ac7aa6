"""What the pipeline leaves below results/, and whether it is whole."""

from __future__ import annotations

import re
from pathlib import Path

from gpf.core.files import read_tensors
from gpf.core.images import read_exr
from stages.commands.benchmark import STAGES

# With `smoke`, no camera path is animated.
SMOKE_STAGES = tuple(stage for stage in STAGES if stage != "animate")

TRAIN, NOVEL = ("front", "left", "right"), ("above", "floor", "inside", "ceiling")


def files_below(folder: Path) -> set[str]:
    """Every file below the folder."""
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def assert_whole(folder: Path) -> None:
    """No temporary files, and every image and tensor file can be read."""
    for path in folder.rglob("*"):
        assert not path.name.startswith("."), path
        if path.suffix == ".exr":
            read_exr(path)
        if path.suffix == ".safetensors":
            name = path.parent.name if path.parent.name == "checkpoints" else path.stem
            kind = {"checkpoints": "checkpoint"}.get(name, name)
            read_tensors(path, "passes" if path.stem[0].isdigit() else kind)


def assert_refused(project, stage: str, words: str, scene: str = "cornell_box") -> None:
    """The stage ends with the words and code 2, and nothing below results/ is touched."""
    before = project.snapshot()
    outcome = project.stage(stage, scene)
    assert re.search(words, outcome.text), outcome.text
    assert outcome.code == 2
    assert outcome.text.count("error:") == 1
    assert "Traceback" not in outcome.text
    assert project.snapshot() == before
