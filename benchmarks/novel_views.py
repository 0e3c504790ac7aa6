"""The quality of novel views from a field, for measurements during its training."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrics.image import psnr
from stages.render import FieldRenderer


def mean_psnr(renderer: FieldRenderer, references: Mapping[str, np.ndarray]) -> float:
    """Mean PSNR of the novel views against their references, dB."""
    work, qualities = renderer.work, []
    for k, view in enumerate(work.views.novel):
        image = renderer.render(view, work.params.render.seed + k).radiance
        qualities.append(psnr(image, references[view.name], work.views.exposure))
    return float(np.mean(qualities))
