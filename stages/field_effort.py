"""What the field is given, for systems that are to have as much."""

from __future__ import annotations

from gpf.baselines.protocol import FieldEffort
from stages.workspace import Workspace


def field_effort(work: Workspace) -> FieldEffort:
    """Steps, points and samples of the field."""
    return FieldEffort(
        steps=work.params.train.steps,
        batch=work.params.train.batch,
        points=work.params.train.points,
        loss=work.params.train.loss,
        spp=work.params.render.spp,
        sampler=work.params.render.sampler,
        adaptive=work.params.render.adaptive,
        suppress_fireflies=work.params.render.suppress_fireflies,
        glossy_walks=work.params.render.glossy_walks,
    )
