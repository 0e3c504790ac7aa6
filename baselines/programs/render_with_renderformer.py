"""Render scene files with RenderFormer; run by :mod:`baselines.renderformer.baseline`.

A request names the scene ``file``, the ``resolution``, and the output file ``image``.
"""

from __future__ import annotations

import importlib
import importlib.util
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
)

Answer = dict[str, Any]


def start(request: Answer) -> tuple[Callable[[Answer], Answer], Answer]:
    """Load the network."""
    folder = find_weights(request["weights"])
    torch = importlib.import_module("torch")
    device = "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cpu":  # otherwise the code imports a package that needs a GPU
        os.environ["ATTN_IMPL"] = "sdpa"
    published = importlib.import_module("renderformer")
    model = load_network(published.RenderFormer, folder)
    if model.config.use_ldr:
        raise Refusal("the weights are for LDR images", "Set the option `weights` to others.")
    if device == "cuda" and importlib.util.find_spec("renderformer_liger_kernel"):
        importlib.import_module("renderformer_liger_kernel").apply_kernels(model)
    pipeline = published.RenderFormerRenderingPipeline(model)
    pipeline.to(torch.device(device))

    def respond(request: Answer) -> Answer:
        return render(pipeline, torch, device, request)

    return respond, describe(model, device)


def render(pipeline: Any, torch: Any, device: str, request: Answer) -> Answer:
    """Write the network's image, linear, (R, R, 3) float32."""
    h5py = importlib.import_module("h5py")
    numpy = importlib.import_module("numpy")
    started = time.perf_counter()
    with h5py.File(request["file"], "r") as file:
        names = ("triangles", "texture", "vn", "c2w", "fov")
        values = {name: numpy.asarray(file[name], dtype=numpy.float32) for name in names}
    # Copies, because the pipeline changes the texture in place; a batch of one scene.
    scene = {name: torch.tensor(value, device=device)[None] for name, value in values.items()}
    mask = torch.ones(scene["triangles"].shape[:2], dtype=torch.bool, device=device)
    images = pipeline(
        triangles=scene["triangles"],
        texture=scene["texture"],
        mask=mask,
        vn=scene["vn"],
        c2w=scene["c2w"],
        fov=scene["fov"][..., None],
        resolution=request["resolution"],
        # The authors render in half precision; on a CPU only single precision works.
        torch_dtype=torch.float16 if device == "cuda" else torch.float32,
    )
    image = images[0, 0, ..., :3].detach().float().cpu().numpy()
    numpy.save(request["image"], image)
    return {"seconds": time.perf_counter() - started, "peak_megabytes": peak_megabytes()}


if __name__ == "__main__":
    converse(start)
