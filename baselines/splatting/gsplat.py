"""A rasteriser that uses gsplat's kernels, which need CUDA."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mitsuba as mi
import numpy as np
import torch

from baselines.optional import import_optional
from baselines.splatting.projection import BLUR, NEAR
from baselines.splatting.rasteriser import NAMES, Drawing, Rasteriser
from gpf.core.structs import from_numpy
from gpf.scene.pinhole import Pinhole


class GsplatRasteriser(Rasteriser):
    """Renders with gsplat; tensors are on the GPU."""

    device = "cuda"

    @property
    def name(self) -> str:
        """The rasteriser's name, for tables."""
        return "gsplat, CUDA"

    def draw(self, tensors: Mapping[str, torch.Tensor], camera: Pinhole, degree: int) -> Drawing:
        """See :meth:`Rasteriser.draw`."""
        gsplat = import_gsplat()
        ordered = [tensors[name] for name in NAMES]
        means, scales, quats, opacities, *harmonics = ordered
        width, height = self.size
        inner = np.diag([camera.focal, camera.focal, 1.0])
        inner[:2, 2] = width / 2, height / 2
        image, _, info = gsplat.rasterization(
            means,
            quats,
            scales.exp(),
            opacities.sigmoid(),
            torch.cat(harmonics, dim=1),
            self._tensor(np.linalg.inv(camera.pose))[None],
            self._tensor(inner)[None],
            width,
            height,
            near_plane=NEAR,
            eps2d=BLUR,
            sh_degree=degree,
            packed=False,
        )
        if image.requires_grad:
            info["means2d"].retain_grad()

        def backward(adjoint: mi.Float) -> None:
            for tensor in ordered:
                tensor.grad = None
            gradient = self._tensor(np.array(adjoint)).reshape(image.shape)
            image.backward(gradient)

        return Drawing(from_numpy(mi.Float, image.detach().cpu().numpy().ravel()), backward, info)

    def _tensor(self, values: np.ndarray) -> torch.Tensor:
        return torch.tensor(values, dtype=torch.float32, device=self.device)


def import_gsplat(part: str = "") -> Any:
    """The package gsplat, or a module of it.

    Raises
    ------
    CannotServe: it is not installed.
    """
    return import_optional(f"gsplat{part}", "gsplat==1.5.3")


def make_rasteriser(size: tuple[int, int]) -> Rasteriser:
    """gsplat's rasteriser if Mitsuba and torch both use CUDA and gsplat's kernels can be built."""
    if mi.variant().startswith("cuda") and torch.cuda.is_available() and _is_built():
        return GsplatRasteriser(size)
    return Rasteriser(size)


def _is_built() -> bool:
    """Whether gsplat has its kernels; this import builds them if there is a compiler."""
    return import_gsplat(".cuda._backend")._C is not None
