"""Render with the add-on in Blender: `python with_addon.py FOLDER FILE.blend OUT.exr WHAT`.

WHAT is "twice", "stop" or "fail". The last line on standard output is JSON.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

import bpy


def main(folder: str, file: str, out: str, what: str) -> None:
    bpy.ops.wm.open_mainfile(filepath=file)
    sys.path.insert(0, str(Path(folder).parent))
    addon = __import__(Path(folder).name)
    addon.COMMAND["environment"] = {"PYTHONPATH": os.environ["GPF_TESTED"]}
    addon.register()
    scene = bpy.context.scene
    scene.render.engine = "PHOTON_FIELD"
    scene.photon_field.seconds, scene.photon_field.samples = 2, 16
    scene.render.resolution_percentage = 50
    image = scene.render.image_settings
    image.media_type, image.file_format = "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER"
    scene.render.filepath = out
    field = addon.folder_of(scene) / "field.safetensors"
    told: dict[str, object] = {}
    if what == "stop":
        started = time.monotonic()
        scene.photon_field.seconds = 600
        passes = addon.folder_of(scene) / "field.fit"
        ready = lambda self: passes.is_dir() and any(passes.iterdir())  # noqa: E731
        asks, addon.Engine.is_stopped = addon.Engine.is_stopped, ready
        bpy.ops.render.render()  # Blender crashes when it is to write a picture that is not there
        told["seconds"] = time.monotonic() - started
        addon.Engine.is_stopped = asks
        scene.photon_field.seconds = 2
        bpy.ops.render.render(write_still=True)
    if what == "fail":
        addon.COMMAND["command"] = [sys.executable, "-c", "import sys; sys.exit('no such luck')"]
        try:
            bpy.ops.render.render(write_still=True)
        except RuntimeError as error:
            told["error"] = str(error)
    if what == "twice":
        bpy.ops.render.render(write_still=True)
        before = field.stat().st_mtime_ns
        scene.camera.location.x += 0.2
        bpy.ops.render.render(write_still=True)
        told["same field"] = field.stat().st_mtime_ns == before
        bpy.data.lights[0].energy *= 2
        bpy.ops.render.render(write_still=True)
        told["new field"] = field.stat().st_mtime_ns != before
    told["field"] = str(field) if field.exists() else None
    addon.unregister()
    others = [p for p in bpy.types.Panel.__subclasses__() if p is not addon.Panel]
    engines = [getattr(panel, "COMPAT_ENGINES", "") for panel in others]
    told["left"] = hasattr(bpy.types.Scene, "photon_field") or "PHOTON_FIELD" in str(engines)
    print(json.dumps(told))


if __name__ == "__main__":
    main(*sys.argv[-4:])
