"""LPIPS with the VGG-16 backbone (Zhang et al. 2018, version 0.1) in plain torch.

VGG-16 computes features f of both images at five depths l. Their distance, with learned weights
w >= 0 for each channel c, is::

    d(x, y) = sum_l mean_hw sum_c w_lc (f_lc(x) / |f_l(x)| - f_lc(y) / |f_l(y)|)^2

Not implemented: other backbones, gradients, dropout (only for training).
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from metrics.weights import find_vgg, read_vgg

CONVOLUTIONS_PER_BLOCK = (2, 2, 3, 3, 3)
"""VGG-16 up to its last ReLU: a 2x2 max-pool between blocks, features at the end of each block."""


class LpipsVGG:
    """The network, made from the arrays that ``metrics.weights`` describes."""

    def __init__(self, arrays: Mapping[str, Any]) -> None:
        vgg = arrays["VGG16_0"]
        self.convolutions = [
            # (height, width, in, out) -> (out, in, height, width)
            (_tensor(layer["kernel"].transpose(3, 2, 0, 1)), _tensor(layer["bias"]))
            for layer in (vgg[f"Conv_{i}"] for i in range(sum(CONVOLUTIONS_PER_BLOCK)))
        ]
        self.heads = [
            _tensor(arrays[f"NetLinLayer_{i}"]["Conv_0"]["kernel"]).reshape(1, -1, 1, 1)
            for i in range(len(CONVOLUTIONS_PER_BLOCK))
        ]
        self.shift = torch.tensor([-0.030, -0.088, -0.188]).reshape(1, 3, 1, 1)
        self.scale = torch.tensor([0.458, 0.448, 0.450]).reshape(1, 3, 1, 1)
        self._last: tuple[Tensor, list[Tensor]] | None = None

    def __call__(self, first: Tensor, second: Tensor) -> Tensor:
        """Distances ``(N,)`` of two batches ``(N, 3, H, W)`` in [-1, 1], sides >= 16.

        The features of ``second`` are kept for the next call, which often has the same reference:
        the images of all methods in a view are compared with one reference.
        """
        with torch.inference_mode():
            if self._last is None or not torch.equal(self._last[0], second):
                self._last = second.clone(), list(self.features(second))
            pairs = zip(self.heads, self.features(first), self._last[1], strict=True)
            terms = [(head * (a - b).square()).sum(dim=1).mean(dim=(1, 2)) for head, a, b in pairs]
            return torch.stack(terms).sum(dim=0)

    def features(self, images: Tensor) -> Iterator[Tensor]:
        """Features of unit length of a batch ``(N, 3, H, W)`` in [-1, 1], one depth at a time."""
        features = (images - self.shift) / self.scale
        layers = iter(self.convolutions)
        for block, count in enumerate(CONVOLUTIONS_PER_BLOCK):
            if block > 0:
                features = functional.max_pool2d(features, 2)
            for _ in range(count):
                features = functional.conv2d(features, *next(layers), padding=1).relu_()
            length = features.square().sum(dim=1, keepdim=True).sqrt()
            yield features / (length + 1e-10)


def distance(
    test: NDArray[np.floating[Any]], reference: NDArray[np.floating[Any]], threads: int = 2
) -> float:
    """LPIPS of two sRGB images ``(H, W, 3)`` in [0, 1], on ``threads`` CPU threads.

    Raises
    ------
    MetricUnavailable: the weights are missing or not the expected ones.
    """
    network = load_vgg(find_vgg())
    first, second = (_tensor(2 * x - 1).permute(2, 0, 1)[None] for x in (test, reference))
    with _torch_threads(threads):
        return float(network(first, second))


@lru_cache(maxsize=1)
def load_vgg(path: Path) -> LpipsVGG:
    """The network with the weights in ``path``, read once per process."""
    return LpipsVGG(read_vgg(path))


@contextmanager
def _torch_threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _tensor(array: NDArray[Any]) -> Tensor:
    # A copy, because torch warns about read-only arrays, and those of a pickle are read-only.
    return torch.from_numpy(np.array(array, dtype=np.float32, order="C"))
