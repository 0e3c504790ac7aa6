"""Trainings that were stopped go on from their checkpoints."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.training.checkpoint import restore_trainer, save_trainer
from gpf.training.trainer import Trainer
from tests.training.plane import arrays_of, make_trainer, run


class Stopped(Exception):
    """What stands for Ctrl-C."""


def stop_at(step: int, trainer: Trainer, path: Path) -> Callable[[int], None]:
    def tick(done: int) -> None:
        if done == step:
            save_trainer(trainer, path, {"run": [1, "a"]})
        if done == step + 7:
            raise Stopped

    return tick


def test_training_goes_on_from_a_checkpoint(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    trainer = make_trainer()
    with pytest.raises(Stopped):
        trainer.run(tick=stop_at(40, trainer, path))
    best = trainer.best_error

    resumed = make_trainer()
    assert restore_trainer(resumed, path, {"run": [1, "a"]}) == ""
    assert resumed.step_count == 40 and resumed.best_error == best
    ticks: list[int] = []
    field = resumed.run(tick=ticks.append)
    assert ticks == list(range(41, 61))
    whole, _ = run(make_trainer())
    np.testing.assert_allclose(arrays_of(field), arrays_of(whole), atol=2e-3)


def test_a_checkpoint_of_other_parameters_is_left_alone(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    trainer = make_trainer()
    with pytest.raises(Stopped):
        trainer.run(tick=stop_at(2, trainer, path))
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
