"""The quality of novel views from a field, for measurements during its training."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gpf.rendering.field_renderer import FieldRenderer
from metrics.image import psnr
from stages.common.workspace import Workspace


def mean_psnr(
    work: Workspace, renderer: FieldRenderer, references: Mapping[str, np.ndarray]
) -> float:
    """Mean PSNR of the novel views against their references, dB."""
    qualities = []
    for k, view in enumerate(work.views.novel):
        seed = work.params.render.seed + k
        image = renderer.render(view, work.film_size, seed)["radiance"]
        qualities.append(psnr(image, references[view.name], work.views.exposure))
    return float(np.mean(qualities))
