"""params.yaml -> the library's settings of training."""

from __future__ import annotations

from gpf.training_settings import LearningRates, TrainingSettings
from stages.workspace import Workspace


def training_settings(work: Workspace) -> TrainingSettings:
    """The library's settings from the sections of params.yaml."""
    section = work.params.train
    return TrainingSettings(
        steps=section.steps,
        batch=section.batch,
        rates=LearningRates(**section.rates.model_dump()),
        final_rate=section.final_rate,
        rebuild_every=section.rebuild_every,
        evaluate_every=section.evaluate_every,
        held_out=section.held_out,
        from_targets=work.params.field.initial_colour == "targets",
        anisotropic=work.params.field.anisotropic,
        seed=section.seed,
    )
