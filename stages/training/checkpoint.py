"""Trainer checkpoints, from which interrupted training resumes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.core.files import read_tensors, write_tensors
from gpf.core.structs import from_numpy
from gpf.training.adam import Adam
from gpf.training.kernels import parameters, with_parameters
from gpf.training.trainer import Progress, Trainer


def save_trainer(
    trainer: Trainer, path: Path, fingerprint: Mapping[str, Any], note: Any = ""
) -> None:
    """Write a checkpoint atomically: parameters, moments, the best state and the history.

    ``note`` is a JSON value that :func:`restore_trainer` returns.
    """
    states = {
        "parameters": parameters(trainer.gaussians),
        "best": parameters(trainer.best),
        "first": trainer.descent.adam.first,
        "second": trainer.descent.adam.second,
    }
    tensors = {name: np.stack([v.numpy() for v in values]) for name, values in states.items()}
    metadata = {
        "step": trainer.step_count,
        "history": [asdict(progress) for progress in trainer.history],
        "note": note,
        "fingerprint": dict(fingerprint),
    }
    write_tensors(path, "checkpoint", tensors, metadata)


def restore_trainer(trainer: Trainer, path: Path, fingerprint: Mapping[str, Any]) -> Any:
    """Restore a trainer from a checkpoint that has the same fingerprint.

    Returns the note, or None if there is no such checkpoint.
    """
    if not path.exists():
        return None
    tensors, metadata = read_tensors(path, "checkpoint")
    if metadata.get("fingerprint") != json.loads(json.dumps(fingerprint)):
        return None
    arrays = {name: [from_numpy(mi.Float, row) for row in value] for name, value in tensors.items()}
    trainer.gaussians = with_parameters(trainer.gaussians, arrays["parameters"])
    trainer.best = with_parameters(trainer.gaussians, arrays["best"])
    trainer.descent.adam = Adam(arrays["first"], arrays["second"])
    trainer.step_count = metadata["step"]
    trainer.history = [Progress(**progress) for progress in metadata["history"]]
    trainer.rebuild()
    return metadata["note"]
