"""Predict Gaussians from images with AnySplat; run by :mod:`baselines.anysplat.baseline`.

A request names the input file ``images``, (K, 448, 448, 3) uint8, and the output file ``splats``.
"""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable
from typing import Any

from conversation import (  # type: ignore[import-not-found]  # in the folder of this script
    Refusal,
    converse,
    describe,
    find_weights,
    load_network,
    peak_megabytes,
    say_how_to_download,
)

Answer = dict[str, Any]

# AnySplat's code loads this network first, before its own weights.
BACKBONE = "facebook/VGGT-1B"


def start(request: Answer) -> tuple[Callable[[Answer], Answer], Answer]:
    """Load the network."""
    folder = find_weights(request["weights"])
    torch = importlib.import_module("torch")
    published = importlib.import_module("src.model.model.anysplat")
    device = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        model = load_network(published.AnySplat, folder)
    except OSError as error:
        raise Refusal(
            f"weights not installed: {BACKBONE} ({error})", f"{say_how_to_download(BACKBONE)}."
        ) from error
    model = model.to(device)

    def respond(request: Answer) -> Answer:
        return infer(model, torch, device, request)

    return respond, describe(model, device)


def infer(model: Any, torch: Any, device: str, request: Answer) -> Answer:
    """Write the network's prediction, float32 arrays.

    ``means`` (N, 3), ``covariances`` (N, 3, 3), ``harmonics`` (N, 3, D) and ``opacities`` (N,) of
    the Gaussians; ``poses`` (K, 4, 4), camera to world; ``intrinsics`` (K, 3, 3), in units of the
    image's width and height; ``background`` (3,); ``seconds`` and ``device``.
    """
    numpy = importlib.import_module("numpy")
    started = time.perf_counter()
    images = torch.from_numpy(numpy.load(request["images"])).to(device)
    images = images.permute(0, 3, 1, 2)[None].float() / 255
    with torch.no_grad():
        gaussians, cameras = model.inference(images)
    found = {
        "means": gaussians.means[0],
        "covariances": gaussians.covariances[0],
        "harmonics": gaussians.harmonics[0],
        "opacities": gaussians.opacities[0].reshape(-1),
        "poses": cameras["extrinsic"][0],
        "intrinsics": cameras["intrinsic"][0],
        "background": model.decoder.background_color,
    }
    arrays = {name: value.detach().float().cpu().numpy() for name, value in found.items()}
    arrays["seconds"] = numpy.float32(time.perf_counter() - started)
    arrays["device"] = numpy.array(device)
    unfinished = request["splats"] + ".unfinished.npz"
    numpy.savez(unfinished, **arrays)
    os.replace(unfinished, request["splats"])
    return {"peak_megabytes": peak_megabytes()}


if __name__ == "__main__":
    converse(start)
