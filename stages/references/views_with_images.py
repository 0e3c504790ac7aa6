"""How many training views have images, from which systems other than the field learn."""

from __future__ import annotations

from stages.common.workspace import Workspace
from stages.config.params import Params
from stages.config.pipeline import OWN_METHODS


def count_views_with_images(work: Workspace) -> int:
    """The number of views with an image: first the training views, then those under ``more``."""
    images = work.params.reference.images
    return count_needed_images(work.params, work.scene) if images == "auto" else images


def count_needed_images(params: Params, scene: str) -> int:
    """The largest number of images that any system to be run for a scene needs."""
    animated = params.animation.methods if scene in params.animation.scenes else ()
    listed = [m for m in (*params.methods.all, *animated) if m not in OWN_METHODS]
    rows = [params.baselines[method] for method in listed]
    needed = [row.training_views for row in rows if not row.scenes or scene in row.scenes]
    return max(needed, default=0)
