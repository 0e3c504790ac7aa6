"""Render a scene by Cycles without its shortcuts: `python traced.py FILE OUT.exr SAMPLES SEED`.

A file called cycles.py would hide the add-on.
"""

from __future__ import annotations

import sys

import bpy


def main(file: str, out: str, samples: str, seed: str) -> None:
    import addon_utils  # only `bpy` makes it known

    bpy.ops.wm.open_mainfile(filepath=file, load_ui=False, use_scripts=False)
    addon_utils.enable("cycles", default_set=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.samples, cycles.seed = int(samples), int(seed)
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    for kind in ("max", "diffuse", "glossy", "transmission", "volume"):
        setattr(cycles, f"{kind}_bounces", 32)
    cycles.transparent_max_bounces = 32
    cycles.sample_clamp_indirect = cycles.sample_clamp_direct = 0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    for thing in bpy.data.objects:
        if thing.type == "LIGHT":
            thing.visible_camera = True
    scene.render.use_compositing = False
    scene.view_settings.view_transform, scene.view_settings.exposure = "Raw", 0
    image = scene.render.image_settings
    image.media_type = "IMAGE"
    image.file_format, image.color_mode, image.color_depth = "OPEN_EXR", "RGB", "32"
    scene.render.filepath, scene.render.use_file_extension = out, False
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main(*sys.argv[-4:])
