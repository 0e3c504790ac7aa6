"""3D Gaussian splatting (Kerbl and others 2023), fitted to pictures of the scene.

What is fitted are images as they are shown: exposed, clipped to [0, 1] and encoded as sRGB, with
the loss of the paper, 0.8 L1 + 0.2 (1 - SSIM). So radiance beyond the clip is not known afterwards,
and a view's radiance is at most the clip. Gaussians start at visible points
(:mod:`gpf.baselines.splatting.seeds`) and are split, doubled and dropped by gsplat's
``DefaultStrategy``. On CUDA gsplat's kernels draw them, where they can be built; elsewhere this
project's own (:mod:`gpf.baselines.splatting.compositing`), by the same equations.

Left out: the resets of opacity, which are for trainings of tens of thousands of steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mitsuba as mi
import numpy as np

from gpf.baselines.options import SplattingOptions
from gpf.baselines.pinhole import Pinhole, make_pinhole
from gpf.baselines.protocol import CannotServe, Task
from gpf.baselines.splatting.gsplat import make_rasteriser
from gpf.baselines.splatting.model import SplatModel, grow_from
from gpf.baselines.splatting.seeds import find_seeds
from gpf.baselines.splatting.training import Picture, Plan, SplatTrainer
from gpf.core.images import tone_map, undo_tone_map
from gpf.scene.bounds import bounding_box
from gpf.scene.views import View


class Splatting:
    """The system, with its options from params.yaml."""

    def __init__(self, options: SplattingOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> FittedSplats:
        """Fit Gaussians to the training views, or go on where an earlier call was stopped."""
        if not task.training:
            raise CannotServe(task.name, "no training views", "Give it at least one.")
        options, file = self.options, task.state / "splats.safetensors"
        pictures = [
            Picture(make_pinhole(shot.view, task.size), tone_map(shot.radiance, task.exposure))
            for shot in task.training
        ]
        rasteriser = make_rasteriser(task.size)
        plan = Plan(options.steps, options.most, options.degree, task.seed)
        trainer = SplatTrainer.resume(file, pictures, rasteriser, plan)
        if trainer is None:
            seeds = find_seeds(task.scene, pictures, options.gaussians, task.seed, task.rr_depth)
            if not len(seeds.points):
                raise CannotServe(
                    task.name, "all training views are black", "Turn one to what is lit."
                )
            tensors = grow_from(seeds, options.degree, rasteriser.device)
            model = SplatModel(tensors, measure(pictures, task.scene))
            trainer = SplatTrainer(model, pictures, rasteriser, plan)
        trainer.run(file, task.report)
        return FittedSplats(trainer, task.exposure)


def measure(pictures: Sequence[Picture], scene: mi.Scene) -> float:
    """The scene's size: how far cameras stand from their middle, as in 3DGS, or shapes from theirs.

    The former alone is 0 for a single view.
    """
    origins = np.stack([picture.camera.origin for picture in pictures])
    return 1.1 * max(
        float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
        for points in (origins, bounding_box(scene))
    )


class FittedSplats:
    """Gaussians that are ready for any view."""

    def __init__(self, trainer: SplatTrainer, exposure: float) -> None:
        self.params, self.exposure = trainer.model.params, exposure
        self.degree, self.rasteriser = trainer.plan.degree, trainer.rasteriser
        self.facts: Mapping[str, float | str] = {
            "steps": trainer.done,
            "gaussians": trainer.model.count,
            "rasteriser": self.rasteriser.name,
            "fitted": "sRGB in [0, 1]",
            "training_psnr": float(np.mean([self._compare(p) for p in trainer.pictures])),
        }

    @property
    def storage_bytes(self) -> int:
        """All parameters of all Gaussians as float32."""
        return sum(value.numel() * value.element_size() for value in self.params.values())

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, at most 1 / exposure, (H, W, 3) float32; nothing in it is random."""
        shown = self._draw(make_pinhole(view, self.rasteriser.size))
        return (undo_tone_map(shown) / self.exposure).astype(np.float32)

    def _draw(self, camera: Pinhole) -> np.ndarray:
        """What a camera sees, as sRGB in [0, 1], (H, W, 3)."""
        width, height = self.rasteriser.size
        flat = self.rasteriser.draw(self.params, camera, self.degree).image
        return np.clip(np.array(flat, dtype=np.float64).reshape(height, width, 3), 0, 1)

    def _compare(self, picture: Picture) -> float:
        """PSNR of a training view, dB."""
        error = np.mean((self._draw(picture.camera) - picture.image) ** 2)
        return float(-10 * np.log10(max(error, 1e-10)))
