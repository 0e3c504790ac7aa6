"""Render with the add-on in Blender: `python with_addon.py ADDON.zip FILE.blend FOLDER WHAT`.

WHAT is "often", "stop", "borders" or "fail". Pictures are written into FOLDER. The last line on
standard output is JSON.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from pathlib import Path

import bpy
import numpy as np

INSTALLED = "bl_ext.user_default.photon_field"


BORDERS = [(29, 0.1, 0.75, 0.3, 1), (58, 0.33, 0.66, 0.01, 0.5), (100, 0, 0.2, 0.17, 0.23)]
BORDERS += [(57, 0.6, 1, 0, 1)]


def write_places(self: object, request: Path) -> bool:
    """In place of `gpf`: a picture whose pixels are their column and row."""
    (left, top), (right, bottom) = json.loads(request.read_text())["region"]
    rows, columns = np.mgrid[top:bottom, left:right].astype(np.float32)
    for name in ("radiance", "normal", "albedo"):
        np.save(request.with_name(f"{name}.npy"), np.stack([columns, rows, rows], axis=2))
    for name in ("depth", "error"):
        np.save(request.with_name(f"{name}.npy"), rows)
    return True


def main(addon_file: str, file: str, out: str, what: str) -> None:
    import addon_utils  # found after bpy was imported

    bpy.ops.wm.open_mainfile(filepath=file)
    addon_utils.enable("bl_pkg")
    bpy.ops.extensions.package_install_files(
        filepath=addon_file, repo="user_default", enable_on_install=True
    )
    addon = sys.modules[INSTALLED]
    addon.COMMAND["environment"] = {"PYTHONPATH": os.environ["GPF_TESTED"]}
    scene = bpy.context.scene
    scene.render.engine = "PHOTON_FIELD"
    scene.photon_field.seconds, scene.photon_field.samples = 2, 16
    scene.render.resolution_percentage = 50
    image = scene.render.image_settings
    image.media_type, image.file_format = "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER"
    field = addon.folder_of(scene) / "field.safetensors"
    told: dict[str, object] = {}

    def render(name: str) -> bool:
        """Render a picture; whether the field is a new one."""
        before = field.stat().st_mtime_ns if field.exists() else 0
        scene.render.filepath = str(Path(out) / name)
        bpy.ops.render.render(write_still=True)
        return field.exists() and field.stat().st_mtime_ns != before

    if what == "stop":
        started = time.monotonic()
        scene.photon_field.seconds = 600
        passes = addon.folder_of(scene) / "field.fit"
        ready = lambda self: any(passes.glob("field-*"))  # noqa: E731
        asks, addon.Engine.is_stopped = addon.Engine.is_stopped, ready
        bpy.ops.render.render()  # Blender crashes when it is to write a picture that is not there
        told["seconds"] = time.monotonic() - started
        addon.Engine.is_stopped = asks
        shutil.copy(field, Path(out) / "stopped.safetensors")
        scene.photon_field.seconds = told["seconds"] + 2
        told["new"] = [render("picture"), render("again")]
    if what == "fail":
        addon.COMMAND["command"] = [sys.executable, "-c", "import sys; sys.exit('no such luck')"]
        try:
            render("picture")
        except RuntimeError as error:
            told["error"] = str(error)
    if what == "borders":
        addon.Engine._run = write_places
        settings = scene.render
        settings.use_border = True
        for k, border in enumerate(BORDERS):
            settings.resolution_percentage, settings.use_crop_to_border = border[0], k % 2 == 1
            settings.border_min_x, settings.border_max_x = border[1:3]
            settings.border_min_y, settings.border_max_y = border[3:]
            render(f"border_{k}")
    if what == "often":
        told["new"] = [render("whole")]
        settings = scene.render
        settings.use_border = True
        settings.border_min_x, settings.border_max_x = 0.26, 0.76
        settings.border_min_y, settings.border_max_y = 0.1, 0.4
        told["new"] += [render("region")]
        settings.use_border = False
        scene.camera.location.x += 0.2
        told["new"] += [render("moved")]
        bpy.data.lights[0].energy *= 2
        told["new"] += [render("brighter")]
        scene.photon_field.groups = True
        told["new"] += [render("grouped")]
    told["field"] = str(field) if field.exists() else None
    addon_utils.disable(INSTALLED)
    others = [p for p in bpy.types.Panel.__subclasses__() if p is not addon.Panel]
    engines = [getattr(panel, "COMPAT_ENGINES", "") for panel in others]
    told["left"] = hasattr(bpy.types.Scene, "photon_field") or "PHOTON_FIELD" in str(engines)
    print(json.dumps(told))


if __name__ == "__main__":
    main(*sys.argv[-4:])
