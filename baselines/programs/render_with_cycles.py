"""Render descriptions of scenes with Cycles, in Blender; run by :mod:`baselines.cycles`.

The first request names the ``folder`` with the description and the settings ``guiding`` and
``caustics``. A further one has a ``camera``, the ``seconds`` or ``samples`` to spend, a ``seed``,
the quality of the ``denoiser`` ("accurate", "fast" or "none") and the output file ``image``.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import bpy
import numpy as np
from conversation import (  # type: ignore[import-not-found]  # in the folder of this script
    Refusal,
    converse,
    peak_megabytes,
)
from cycles_scene import Scene  # type: ignore[import-not-found]
from mathutils import Matrix

Answer = dict[str, Any]

MOST_SAMPLES = 1 << 24
DEEPEST = 128


def start(request: Answer) -> tuple[Callable[[Answer], Answer], Answer]:
    """Build the scene."""
    if bpy.app.version < (4, 3):
        raise Refusal(f"Blender {bpy.app.version_string} is too old", "Use 4.3 or later.")
    folder = Path(request["folder"])
    Scene(folder, request["caustics"])
    set_up(request)

    def respond(request: Answer) -> Answer:
        return render(request, folder)

    return respond, {"version": f"Blender {bpy.app.version_string}", "device": "cpu"}


def set_up(request: Answer) -> None:
    """The settings of Cycles, except for those of a view."""
    import addon_utils  # only `bpy` makes it known

    addon_utils.enable("cycles", default_set=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.use_persistent_data = True
    cycles = scene.cycles
    cycles.use_guiding, cycles.use_adaptive_sampling = request["guiding"], False
    cycles.denoiser, cycles.denoising_input_passes = "OPENIMAGEDENOISE", "RGB_ALBEDO_NORMAL"
    for kind in ("max", "diffuse", "glossy", "transmission"):
        setattr(cycles, f"{kind}_bounces", DEEPEST)
    cycles.transparent_max_bounces = DEEPEST
    cycles.sample_clamp_indirect = cycles.sample_clamp_direct = 0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    scene.render.use_compositing = scene.render.use_sequencer = False
    scene.view_settings.view_transform = "Raw"
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_mode, image.color_depth = "OPEN_EXR", "RGB", "32"


def render(request: Answer, folder: Path) -> Answer:
    """Write an image, linear, (H, W, 3) float32."""
    started = time.perf_counter()
    scene = bpy.context.scene
    look(request["camera"])
    cycles, quality = scene.cycles, request["denoiser"]
    cycles.use_denoising = quality != "none"
    cycles.denoising_prefilter = "ACCURATE" if quality == "accurate" else "FAST"
    cycles.denoising_quality = "HIGH" if quality == "accurate" else "FAST"
    cycles.seed = request["seed"] % (1 << 31)
    cycles.time_limit = request.get("seconds", 0)
    cycles.samples = request.get("samples", MOST_SAMPLES)
    file = folder / "rendered.exr"
    scene.render.filepath, scene.render.use_file_extension = str(file), False
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(file), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    width, height = request["camera"]["size"]
    np.save(request["image"], pixels.reshape(height, width, -1)[::-1, :, :3])
    return {"seconds": time.perf_counter() - started, "peak_megabytes": peak_megabytes()}


def look(camera: dict[str, Any]) -> None:
    """Move the camera."""
    scene = bpy.context.scene
    if scene.camera is None:
        scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        scene.collection.objects.link(scene.camera)
    width, height = camera["size"]
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100
    data = scene.camera.data
    data.sensor_fit, data.lens_unit = "HORIZONTAL", "FOV"
    data.angle = 2 * math.atan(width / 2 / camera["focal"])
    data.shift_x = 0.5 - camera["centre"][0] / width
    data.shift_y = (camera["centre"][1] - height / 2) / width
    data.clip_start, data.clip_end = 1e-3, 1e5
    right, down, ahead = np.array(camera["rotation"]).T
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, -down, -ahead], axis=1)
    matrix[:3, 3] = camera["origin"]
    scene.camera.matrix_world = Matrix(matrix.tolist())


if __name__ == "__main__":
    converse(start)
