"""3D Gaussian splatting (Kerbl and others 2023), fitted to images of the scene.

The Gaussians are fitted to tone-mapped images, exposed, clipped to [0, 1] and encoded as sRGB, with
the loss of the paper, 0.8 L1 + 0.2 (1 - SSIM). So the radiance of a rendered view is at most the
clipping value. Gaussians start at visible points (:mod:`baselines.splatting.seeds`); gsplat's
``DefaultStrategy`` splits, doubles and removes them. On CUDA, gsplat's kernels render them if the
kernels can be built; otherwise this project's own kernels do
(:mod:`baselines.splatting.compositing`), with the same equations.

Left out: the resets of opacity, which suit training runs of tens of thousands of steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mitsuba as mi
import numpy as np

from baselines.options import SplattingOptions
from baselines.protocol import CannotServe, Task
from baselines.splatting.gsplat import make_rasteriser
from baselines.splatting.model import SplatModel, grow_from
from baselines.splatting.seeds import find_seeds
from baselines.splatting.training import Picture, Plan, SplatTrainer
from gpf.core.images import tone_map, undo_tone_map
from gpf.scene.bounds import bounding_box
from gpf.scene.pinhole import Pinhole, make_pinhole
from gpf.scene.views import View


class Splatting:
    """The system with its options."""

    def __init__(self, options: SplattingOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> FittedSplats:
        """Fit Gaussians to the training views, continuing from the last checkpoint if there is one.

        Raises
        ------
        CannotServe: there are no training views, all are black, or gsplat is missing.
        """
        if not task.training:
            raise CannotServe(task.name, "has no training views", "Give it at least one.")
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
                    task.name, "all training views are black", "Point one at a lit surface."
                )
            tensors = grow_from(seeds, options.degree, rasteriser.device)
            model = SplatModel(tensors, measure(pictures, task.scene))
            trainer = SplatTrainer(model, pictures, rasteriser, plan)
        trainer.run(file, task.report)
        return FittedSplats(trainer, task.exposure)


def measure(pictures: Sequence[Picture], scene: mi.Scene) -> float:
    """The scene's size, world units: 1.1 times the largest distance of cameras from their mean, as
    in 3DGS, or of the bounding box's corners from its middle, if that is larger.

    The cameras alone would give 0 for a single view.
    """
    origins = np.stack([picture.camera.origin for picture in pictures])
    return 1.1 * max(
        float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
        for points in (origins, bounding_box(scene))
    )


class FittedSplats:
    """Fitted Gaussians."""

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
        """A view's radiance, at most 1 / exposure, (H, W, 3) float32; deterministic."""
        shown = self._draw(make_pinhole(view, self.rasteriser.size))
        return (undo_tone_map(shown) / self.exposure).astype(np.float32)

    def _draw(self, camera: Pinhole) -> np.ndarray:
        """A camera's image, sRGB in [0, 1], (H, W, 3)."""
        width, height = self.rasteriser.size
        flat = self.rasteriser.draw(self.params, camera, self.degree).image
        return np.clip(np.array(flat, dtype=np.float64).reshape(height, width, 3), 0, 1)

    def _compare(self, picture: Picture) -> float:
        """PSNR of a training view, dB."""
        error = np.mean((self._draw(picture.camera) - picture.image) ** 2)
        return float(-10 * np.log10(max(error, 1e-10)))
