"""How many Gaussians pay, where the number is left open.

With more of them a field can show more detail; with fewer, each has more photons to learn from, and
the field is free of noise that many would keep. Where light is smooth, a few thousand are better
than a hundred thousand.
"""

from __future__ import annotations

import logging
from typing import Any

from gpf.core.structs import Photons
from gpf.training.recipe import Recipe
from gpf.training.settings import TrainingSettings
from gpf.training.streaming import PhotonStream
from gpf.training.targets import Targets

# Tried one after another, as shares of the largest number, until the error rises. From the largest
# down: where shadows have edges, a quarter of the Gaussians may be worse than a sixteenth.
SHARES = (1, 1 / 4, 1 / 16)

# Part of all steps that a trial takes. In shorter ones, the noise that points share has not been
# learned yet, so that only judges who know other noise can tell.
TRIAL, TRIAL_WITH_JUDGES = 0.5, 0.2

# With judges, one in so many points is enough, and batches that are as much smaller.
JUDGED_EVERY = 4

log = logging.getLogger(__name__)


def choose_count(
    recipe: Recipe,
    photons: Photons,
    targets: Targets,
    bounds: tuple[Any, Any],
    stream: PhotonStream | None = None,
) -> int:
    """The number of Gaussians whose field is best after a short training.

    It is judged at points that training does not see. Targets of a stream have so much noise, which
    neighbours share, that they would not tell noise from light: other photons judge there.

    Parameters
    ----------
    photons, targets: that the field starts from and learns from.
    bounds: corners of the scene's bounding box.
    stream: of the targets, if they come from one.
    """
    if recipe.field.gaussians != "auto":
        return recipe.field.gaussians
    best, least = recipe.max_gaussians, float("inf")
    if recipe.train.held_out == 0:
        return best
    settings, judges = _trial_settings(recipe.train, TRIAL), None
    if stream is not None:
        settings = _trial_settings(recipe.train, TRIAL_WITH_JUDGES, JUDGED_EVERY)
        targets = Targets(**{name: rows[::JUDGED_EVERY] for name, rows in vars(targets).items()})
        judges = recipe.supervise(stream.independent(JUDGED_EVERY).targets())
    points = recipe.supervise(targets)
    for share in SHARES:
        count = round(recipe.max_gaussians * share)
        trainer = recipe.trainer(
            recipe.initial_field(count, photons, targets, bounds), points, settings
        )
        trainer.advance(settings.steps)
        if judges is not None:
            trainer.retarget(judges)
        error = trainer.judge().held_out_error
        if error >= least:
            break
        best, least = count, error
    log.info("%s Gaussians", best)
    return best


def _trial_settings(whole: TrainingSettings, share: float, every: int = 1) -> TrainingSettings:
    """Those of a share of all steps, with batches of one in so many points."""
    steps = max(round(whole.steps * share), 1)
    return whole.model_copy(
        update={
            "steps": steps,
            "batch": max(whole.batch // every, 1),
            "rebuild_every": min(whole.rebuild_every, steps),
        }
    )
