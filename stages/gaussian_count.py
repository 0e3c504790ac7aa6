"""How many Gaussians pay, where params.yaml leaves it open.

With more of them a field can show more detail; with fewer, each has more photons to learn from, and
the field is free of noise that many would keep. Where light is smooth, a few thousand are better
than a hundred thousand.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from gpf.streaming import PhotonStream
from gpf.structs import Photons
from gpf.supervision import Targets
from gpf.training import Trainer
from gpf.training_settings import TrainingSettings
from stages.most_gaussians import most_gaussians
from stages.progress import say
from stages.train_settings import training_settings
from stages.training_inputs import initial_field, supervise
from stages.workspace import Workspace

# Tried one after another, as shares of the most there may be, until the error rises. From the most
# down: where shadows have edges, a quarter of the Gaussians may be worse than a sixteenth.
SHARES = (1, 1 / 4, 1 / 16)

# Part of all steps that a trial takes. In shorter ones, the noise that points share has not been
# learned yet, so that only judges who know other noise can tell.
TRIAL, TRIAL_WITH_JUDGES = 0.5, 0.2

# With judges, one in so many points is enough, and batches that are as much smaller.
JUDGED_EVERY = 4


def choose_count(
    work: Workspace,
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
    section = work.params.field
    if section.gaussians != "auto":
        return section.gaussians
    most = most_gaussians(section.gaussians)
    best, least = most, float("inf")
    if work.params.train.held_out == 0:
        return best
    settings, judges = _settings(work, TRIAL), None
    if stream is not None:
        settings = _settings(work, TRIAL_WITH_JUDGES, JUDGED_EVERY)
        targets = Targets(**{name: rows[::JUDGED_EVERY] for name, rows in vars(targets).items()})
        judges = supervise(work, stream.independent(JUDGED_EVERY).targets())
    points = supervise(work, targets)
    for share in SHARES:
        count = round(most * share)
        field = initial_field(work, count, photons, targets, bounds)
        trainer = Trainer(field, points, settings)
        trainer.advance(settings.steps)
        if judges is not None:
            trainer.retarget(judges)
        error = trainer.judge().held_out_error
        if error >= least:
            break
        best, least = count, error
    say(f"{work.scene}: {best} Gaussians")
    return best


def _settings(work: Workspace, share: float, every: int = 1) -> TrainingSettings:
    """Those of a share of all steps, with batches of one in so many points."""
    whole = training_settings(work)
    steps = max(round(whole.steps * share), 1)
    return replace(
        whole,
        steps=steps,
        batch=max(whole.batch // every, 1),
        rebuild_every=min(whole.rebuild_every, steps),
    )
