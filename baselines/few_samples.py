"""The field itself with few camera samples per pixel, with or without a denoiser."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from baselines.options import FewSamplesOptions
from baselines.protocol import CannotServe, Task
from gpf.field.io import load_field
from gpf.rendering.denoiser import PACKAGE, available
from gpf.rendering.field_renderer import FieldRenderer
from gpf.scene.views import View


class FewSamples:
    """The scene's trained field, rendered fast enough for viewers and films."""

    def __init__(self, options: FewSamplesOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedFewSamples:
        """Load the field.

        Raises
        ------
        CannotServe: the denoiser's package is missing.
        """
        options, file = self.options, task.field.file
        assert file is not None
        if options.denoise and not available():
            raise CannotServe(
                f"scene {task.name}",
                "the package pyoidn is missing",
                f"Run `pip install {PACKAGE}`.",
            )
        changed = {"spp": options.spp, "denoise": options.denoise}
        settings = task.field.render.model_copy(update=changed)
        renderer = FieldRenderer.make(task.scene, load_field(file), settings)
        return PreparedFewSamples(task, renderer, file.stat().st_size)


@dataclass(frozen=True)
class PreparedFewSamples:
    """A scene with its field."""

    task: Task
    renderer: FieldRenderer
    storage_bytes: int

    @property
    def facts(self) -> Mapping[str, float | str]:
        """Samples per pixel."""
        return {"spp": self.renderer.settings.spp}

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear."""
        image = self.renderer.render(view, self.task.size, seed)["radiance"]
        return np.asarray(image, dtype=np.float32)
