"""The search for the number of Gaussians, with ``gaussians: auto``.

With more Gaussians a field shows more detail. With fewer, each learns from more photons, and the
field has less noise: for smooth light, a few thousand are better than a hundred thousand.
"""

from __future__ import annotations

from typing import Any

from gpf.core.progress import say
from gpf.core.structs import Photons
from gpf.training.targets import Targets
from stages.config.training import most_gaussians
from stages.training.recipe import Recipe

# Numbers to try in this order, as shares of the largest, until the error rises. The largest comes
# first: with sharp shadows, a quarter of the Gaussians may be worse than a sixteenth.
SHARES = (1, 1 / 4, 1 / 16)

# Length of a trial training, as a share of all steps. In a shorter trial the field would not yet
# have learned the noise that neighbouring points share.
TRIAL = 0.5


def choose_count(
    recipe: Recipe, photons: Photons, targets: Targets, bounds: tuple[Any, Any]
) -> int:
    """The number of Gaussians whose field has the least error at held-out points after a short
    training.

    Parameters
    ----------
    photons, targets: the field starts from the photons and learns from the targets.
    bounds: corners of the scene's bounding box.
    """
    if recipe.field.gaussians != "auto":
        return recipe.field.gaussians
    best, least = most_gaussians(recipe.field.gaussians), float("inf")
    if recipe.train.held_out == 0:
        return best
    steps = max(round(recipe.train.steps * TRIAL), 1)
    shorter = {"steps": steps, "rebuild_every": min(recipe.train.rebuild_every, steps)}
    settings, points = recipe.train.model_copy(update=shorter), recipe.supervise(targets)
    for share in SHARES:
        count = round(most_gaussians(recipe.field.gaussians) * share)
        trainer = recipe.trainer(
            recipe.initial_field(count, photons, targets, bounds), points, settings
        )
        trainer.advance(settings.steps)
        error = trainer.judge().held_out_error
        if error >= least:
            break
        best, least = count, error
    say(f"{best} Gaussians")
    return best
