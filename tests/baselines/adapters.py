"""What the tests of adapters to other people's code share."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import mitsuba as mi
import numpy as np
from safetensors.numpy import save_file

from baselines.official import PROGRAMS
from baselines.protocol import Task, TrainingView

STAND_INS = Path(__file__).parent / "stand_ins"


def make_task(
    state: Path, scene: mi.Scene, size: tuple[int, int], training: tuple[TrainingView, ...] = ()
) -> Task:
    return Task(
        name="test",
        scene=scene,
        file=Path("scene.xml"),
        size=size,
        exposure=0.5,
        training=training,
        rr_depth=5,
        seed=1,
        state=state,
    )


def write_weights(folder: Path, tensors: dict[str, Any]) -> str:
    """A folder like those of the Hugging Face hub; its name."""
    folder.mkdir(parents=True)
    (folder / "config.json").write_text("{}")
    arrays = {name: np.ascontiguousarray(value, np.float32) for name, value in tensors.items()}
    save_file(arrays, folder / "model.safetensors")
    return str(folder)


def load_program(name: str) -> ModuleType:
    """A file of baselines/programs, which is no module of the package when it runs."""
    spec = importlib.util.spec_from_file_location(name, PROGRAMS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
