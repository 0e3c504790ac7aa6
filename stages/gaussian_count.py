"""How many Gaussians pay, where params.yaml leaves it open.

With more of them a field can show more detail; with fewer, each has more photons to learn from, and
the field is free of noise that many would keep. Where light is smooth, a few thousand are better
than a hundred thousand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from gpf.field import GaussianPhotonField
from gpf.structs import SurfacePoints
from gpf.training import Trainer
from stages.progress import console
from stages.train_settings import training_settings
from stages.workspace import Workspace

# Tried one after another, as shares of the most there may be, until the error rises. From the most
# down: where shadows have edges, a quarter of the Gaussians may be worse than a sixteenth.
SHARES = (1, 1 / 4, 1 / 16)

# Part of all steps that a trial takes. In shorter ones, the noise that points share has not been
# learned yet, so that only judges who know other noise can tell.
TRIAL, TRIAL_WITH_JUDGES = 0.5, 0.2


def choose_count(
    work: Workspace,
    make_field: Callable[[int], GaussianPhotonField],
    points: SurfacePoints,
    judges: SurfacePoints | None = None,
) -> int:
    """The number of Gaussians whose field is best after a short training.

    It is judged at the points that training does not see.

    Parameters
    ----------
    make_field: the field before training, with so many Gaussians.
    points: what training learns from, (P,).
    judges: the same points with targets of other photons, where those of ``points`` have so much
        noise, which neighbours share, that they would not tell noise from light.
    """
    section = work.params.field
    if section.gaussians != "auto":
        return section.gaussians
    best, least = section.most_gaussians, float("inf")
    if work.params.train.held_out == 0:
        return best
    whole = training_settings(work)
    steps = max(round(whole.steps * (TRIAL if judges is None else TRIAL_WITH_JUDGES)), 1)
    settings = replace(whole, steps=steps, rebuild_every=min(whole.rebuild_every, steps))
    for share in SHARES:
        count = round(section.most_gaussians * share)
        trainer = Trainer(make_field(count), points, settings)
        trainer.advance(steps)
        if judges is not None:
            trainer.retarget(judges)
        error = trainer.judge().held_out_error
        if error >= least:
            break
        best, least = count, error
    console.print(f"{work.scene}: {best} Gaussians", highlight=False)
    return best
