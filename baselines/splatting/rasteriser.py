"""Images of Gaussians in torch tensors, and the gradients of a loss for these tensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import torch

from baselines.splatting.compositing import Compositor
from baselines.splatting.projection import Projector, SplatArrays, project
from baselines.splatting.tiles import sort_into_tiles
from gpf.core.structs import from_numpy
from gpf.scene.pinhole import Pinhole

# gsplat's names for the arrays of SplatArrays, in their order.
NAMES = ("means", "scales", "quats", "opacities", "sh0", "shN")


@dataclass
class Drawing:
    """An image of Gaussians, with the function for its gradients.

    Attributes
    ----------
    image: flat, (3 W H,), by row, column, channel.
    backward: takes the derivative of a loss for the image, and sets ``grad`` of the Gaussians'
        tensors and of ``info["means2d"]``.
    info: input for gsplat's strategies.
    """

    image: mi.Float
    backward: Callable[[mi.Float], None]
    info: dict[str, Any]


class Rasteriser:
    """Renders with this project's own kernels, on any device; torch tensors are on the CPU.

    Parameters
    ----------
    size: width and height of the images, pixels.
    """

    device = "cpu"

    @property
    def name(self) -> str:
        """The rasteriser's name, for tables."""
        return f"own kernels, {mi.variant()}"

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size

    def draw(self, tensors: Mapping[str, torch.Tensor], camera: Pinhole, degree: int) -> Drawing:
        """Render Gaussians with harmonics up to a degree.

        ``tensors`` are the arrays of :class:`SplatArrays` with the names of :data:`NAMES`, one row
        per Gaussian.
        """
        ordered = [tensors[name] for name in NAMES]
        splats = SplatArrays(*(from_numpy(mi.Float, t.detach().numpy().ravel()) for t in ordered))
        dr.enable_grad(splats)
        found = project(splats, Projector.of(camera), degree)
        seen = dr.detach(found)
        dr.eval(seen)
        compositor = Compositor(seen, sort_into_tiles(seen, self.size))
        centres = torch.zeros(1, len(ordered[0]), 2)
        width, height = self.size
        info = {
            "means2d": centres,
            "width": width,
            "height": height,
            "n_cameras": 1,
            "radii": _to_torch(dr.ravel(seen.extents), centres),
            "gaussian_ids": None,
        }

        def backward(adjoint: mi.Float) -> None:
            gradients = compositor.gradients(adjoint)
            dr.set_grad(found, gradients)
            dr.enqueue(dr.ADMode.Backward, found)
            dr.traverse(dr.ADMode.Backward)
            result = dr.grad(splats)
            dr.eval(result)
            centres.grad = _to_torch(dr.ravel(gradients.centres), centres)
            for tensor, gradient in zip(ordered, result.arrays(), strict=True):
                tensor.grad = _to_torch(gradient, tensor)

        return Drawing(compositor.image(), backward, info)


def _to_torch(flat: mi.Float, like: torch.Tensor) -> torch.Tensor:
    """A tensor with the shape of another, even if that has no elements."""
    if not like.numel():
        return torch.zeros_like(like)
    return torch.from_numpy(flat.numpy()).reshape(like.shape)
