"""The search for the number of Gaussians, with ``gaussians: auto``.

With more Gaussians a field shows more detail. With fewer, each learns from more photons, and the
field has less noise: for smooth light, a few thousand are better than a hundred thousand.
"""

from __future__ import annotations

import logging
from typing import Any

from gpf.core.structs import Photons
from gpf.training.recipe import Recipe
from gpf.training.settings import TrainingSettings
from gpf.training.streaming import PhotonStream
from gpf.training.targets import Targets

# Numbers that are tried in this order, as shares of the largest, until the error rises. The largest
# comes first: with sharp shadows, a quarter of the Gaussians may be worse than a sixteenth.
SHARES = (1, 1 / 4, 1 / 16)

# Length of a trial training, as a share of all steps. In a shorter trial the field has not yet
# learned the noise that neighbouring points share; then only judges with other noise can show it.
TRIAL, TRIAL_WITH_JUDGES = 0.5, 0.2

# With judges, a trial uses every fourth point, and batches of a quarter of the size.
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

    Fields are compared by their error at held-out points. Targets of a stream have much noise,
    which neighbouring points share, so their held-out points cannot tell noise from light. For a
    stream, targets from independent photons are used instead (the judges).

    Parameters
    ----------
    photons, targets: the field starts from the photons and learns from the targets.
    bounds: corners of the scene's bounding box.
    stream: the source of the targets, if they come from a stream.
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
    """Settings of a trial: a share of all steps, and 1 / ``every`` of the batch."""
    steps = max(round(whole.steps * share), 1)
    return whole.model_copy(
        update={
            "steps": steps,
            "batch": max(whole.batch // every, 1),
            "rebuild_every": min(whole.rebuild_every, steps),
        }
    )
