"""Which training views have an image beside their points: systems learn from images, the field
from points."""

from __future__ import annotations

from gpf.config.params import Params
from gpf.config.pipeline import OWN_METHODS
from stages.common.workspace import Workspace


def images_of(work: Workspace) -> int:
    """How many of the training views, and then of the `more`, have one."""
    images = work.params.reference.images
    return images_to_learn_from(work.params, work.scene) if images == "auto" else images


def images_to_learn_from(params: Params, scene: str) -> int:
    """As many as any system needs that is run for a scene."""
    animated = params.animation.methods if scene in params.animation.scenes else ()
    listed = [m for m in (*params.methods.all, *animated) if m not in OWN_METHODS]
    rows = [params.baselines[method] for method in listed]
    meant = [row.training_views for row in rows if not row.scenes or scene in row.scenes]
    return max(meant, default=0)
