"""What the pipeline leaves below results/, and whether it is whole."""

from __future__ import annotations

import re
from pathlib import Path

from gpf.core.files import read_tensors
from gpf.core.images import read_exr
from stages.commands.stage import STAGES

# With `smoke`, no camera path is animated.
SMOKE_STAGES = tuple(stage for stage in STAGES if stage != "animate")

TRAIN, NOVEL = ("front", "left", "right"), ("above", "floor", "inside", "ceiling")


# Of the field's images against the references, at the sizes of `smoke`. Over seeds and ways of
# supervision the mean is 24.7 dB, with a standard deviation of 0.25 dB; a fifth more or less light
# would leave 22.7 to 23.2 dB.
LEAST_PSNR = 23.4


def share_of_light(results: Path) -> float:
    """The light in the field's images over that in the references, of all novel views.

    Over seeds, at the sizes of `smoke`, the standard deviation is 3 %.
    """
    found = 0.0, 0.0
    for view in NOVEL:
        files = results / "renders" / "gpf" / f"{view}.exr", results / "reference" / f"{view}.exr"
        means = (float(read_exr(file)[0]["radiance"].mean()) for file in files)
        found = tuple(total + mean for total, mean in zip(found, means, strict=True))
    return found[0] / found[1]


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
