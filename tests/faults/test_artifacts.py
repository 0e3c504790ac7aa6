"""Damaged artifacts, and those of something else: words, and no file is touched; or the stage makes
them again, and the bits are those of before."""

from __future__ import annotations

import json
import random
from pathlib import Path

import numpy as np
import pytest

from gpf.core.files import read_json, read_tensors, write_json, write_tensors
from gpf.core.images import read_exr, write_exr
from tests.faults.cases import CASES, in_turn
from tests.faults.runner import SEED
from tests.faults.wholeness import contents
from tests.stages.conftest import SCENE

# Stage and a file that it reads, below the scene's results.
READ = [
    ("photons", "views.yaml"),
    ("train", "targets.safetensors"),
    ("train", "photons.safetensors"),
    ("render", "field.safetensors"),
    ("reference", "reference/left.exr"),
    ("reference", "reference/surfaces.safetensors"),
    ("reference", "costs/reference.json"),
    ("metrics", "reference/above.exr"),
    ("metrics", "second_reference/inside.exr"),
    ("metrics", "renders/gpf/floor.exr"),
    ("ablation", "reference/above.exr"),
    ("animate", "field.safetensors"),
    ("animate", "animation/gpf/01.exr"),
    ("amortize", "costs/render.json"),
    ("amortize", "costs/train.json"),
    ("amortize", "metrics/gpf.json"),
    ("amortize", "convergence.json"),
    ("report", "metrics/gpf.json"),
    ("report", "costs/render.json"),
    ("report", "convergence.json"),
    ("report", "reference/above.exr"),
]


def flip(path, chance) -> None:
    """Flip a bit."""
    data = bytearray(path.read_bytes())
    place = chance.randrange(len(data))
    data[place] ^= 1 << chance.randrange(7)  # text stays text
    path.write_bytes(data)


def cut(path, chance) -> None:
    """Keep some tenths of the bytes."""
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * chance.randrange(10) // 10])


def add_nan(path, chance) -> None:
    """Put NaN in."""
    if path.suffix == ".exr":
        layers, record = read_exr(path)
        next(iter(layers.values()))[0, 0] = np.nan
        write_exr(path, layers, {k: v for k, v in record.items() if k != "schema_version"})
    else:
        tensors, metadata = read_tensors(path, path.stem)
        name = chance.choice([n for n, v in tensors.items() if v.dtype.kind == "f"])
        tensors[name].reshape(-1)[0] = np.nan
        write_tensors(path, path.stem, tensors, metadata)


def leave_out(path, chance) -> None:
    """Take a layer, a tensor or a key away."""
    if path.suffix == ".exr":
        layers, record = read_exr(path)
        layers.pop(chance.choice(sorted(layers)))
        write_exr(path, layers or {"x": np.zeros((2, 2))}, {"view": record.get("view")})
    elif path.suffix == ".safetensors":
        tensors, metadata = read_tensors(path, path.stem)
        tensors.pop(chance.choice(sorted(tensors)))
        write_tensors(path, path.stem, tensors, metadata)
    else:
        found = read_json(path)
        found.pop(chance.choice(sorted(found)) if isinstance(found, dict) else 0)
        write_json(path, found)


def reshape(path, chance) -> None:
    """Make JSON of another shape."""
    path.write_text(json.dumps(chance.choice([[], {}, 7, None, "text", [1], {"parts": 3}])))


DAMAGES = {
    ".yaml": (cut,),
    ".json": (flip, cut, leave_out, reshape),
    ".exr": (flip, cut, add_nan, leave_out),
    ".safetensors": (flip, cut, add_nan, leave_out),
}
CASES_OF_DAMAGE = [
    (stage, name, damage) for stage, name in READ for damage in DAMAGES[Path(name).suffix]
]


@pytest.mark.slow
@pytest.mark.parametrize(("stage", "name", "damage"), in_turn(CASES_OF_DAMAGE))
def test_a_damaged_file_is_refused_or_made_again(ready, runner, tmp_path, stage, name, damage):
    """Nothing else has changed since the stage has run."""
    project = ready.copy(tmp_path / "project")
    path = project.folder / "results" / SCENE / name
    damage(path, random.Random(f"{SEED} {stage} {name} {damage.__name__}"))
    before = project.snapshot()
    ending = runner.run(project.folder, *CASES[stage].arguments)
    assert ending.code == 0 or ending.is_in_words(), ending.said
    if ending.code and stage != "report":  # which says what is wrong when it comes to it
        assert project.snapshot() == before
    elif ending.code == 0 and damage in (flip, cut) and path.suffix in (".exr", ".safetensors"):
        assert contents(project.folder / "results") == contents(ready.folder / "results")
