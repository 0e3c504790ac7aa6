"""Trainings that were stopped go on from their checkpoints."""

from pathlib import Path

import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.training.trainer import Trainer
from stages.training.checkpoint import restore_trainer, save_trainer
from tests.training.plane import arrays_of, make_trainer, run


def stop_after(step: int, trainer: Trainer, path: Path) -> None:
    """Save after a step, and go on for seven more."""
    for _ in trainer.steps():
        if trainer.step_count == step:
            save_trainer(trainer, path, {"run": [1, "a"]})
        if trainer.step_count == step + 7:
            return


def test_training_goes_on_from_a_checkpoint(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    trainer = make_trainer()
    stop_after(40, trainer, path)
    best = trainer.best_error

    resumed = make_trainer()
    assert restore_trainer(resumed, path, {"run": [1, "a"]}) == ""
    assert resumed.step_count == 40 and resumed.best_error == best
    assert [resumed.step_count for _ in resumed.steps()] == list(range(41, 61))
    field = resumed.finish()
    whole, _ = run(make_trainer())
    np.testing.assert_allclose(arrays_of(field), arrays_of(whole), atol=2e-3)


def test_a_checkpoint_of_other_parameters_is_left_alone(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    trainer = make_trainer()
    stop_after(2, trainer, path)
    fresh = make_trainer()
    assert not restore_trainer(fresh, path, {"run": [2, "a"]})
    assert not restore_trainer(fresh, tmp_path / "none.safetensors", {"run": [1, "a"]})
    assert fresh.step_count == 0


def test_a_truncated_checkpoint_is_said_in_words(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    trainer = make_trainer()
    save_trainer(trainer, path, {})
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(UserError, match=r"is truncated or damaged.*Delete it and make it again"):
        restore_trainer(trainer, path, {})
