"""A render engine that has `gpf` fit a photon field to the scene, and render from it.

`gpf` runs as a process of its own, with the command in `command.json`. It gets a copy of the scene
as a .blend file. The field is kept beside the scene's own file, and used again while geometry,
materials and lamps are the same: a camera that moves needs no other one. More time adds to it.
"""

import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import bpy
import numpy as np

COMMAND = json.loads((Path(__file__).parent / "command.json").read_text(encoding="utf-8"))

# Layer of `gpf` -> Blender's pass: name, channels, their names, kind.
PASSES = {
    "depth": ("Depth", 1, "Z", "VALUE"),
    "normal": ("Normal", 3, "XYZ", "VECTOR"),
    "albedo": ("Albedo", 3, "RGB", "COLOR"),
    "error": ("Error", 1, "X", "VALUE"),
}

PATIENCE = 60
"""Seconds that `gpf` gets to save its field when it is stopped."""


class Settings(bpy.types.PropertyGroup):
    """The panel's settings, `scene.photon_field`."""

    seconds: bpy.props.FloatProperty(
        name="Fit", description="Seconds for the field", default=60, min=1, subtype="TIME_ABSOLUTE"
    )
    samples: bpy.props.IntProperty(
        name="Samples", description="Samples per pixel", default=64, min=1, soft_max=1024
    )
    groups: bpy.props.BoolProperty(
        name="Light Groups",
        description="Keep the light of each lamp apart in the field, to dim it in `gpf view`",
    )


def folder_of(scene) -> Path:
    """Where a scene's field is kept: beside its file, or until Blender ends."""
    if bpy.data.filepath:
        file = Path(bpy.data.filepath)
        return file.with_name(f"{file.stem}.photon_field")
    return Path(bpy.app.tempdir or tempfile.gettempdir()) / "photon_field"


def find_region(render, size) -> np.ndarray:
    """The first and last column and row that are rendered, from the upper left: [[x, y], [x, y]],
    the last not included."""
    border = [render.border_min_x, render.border_max_y, render.border_max_x, render.border_min_y]
    corners = np.float32(border if render.use_border else [0, 1, 1, 0]).reshape(2, 2)
    found = (corners * np.float32(size)).astype(int)  # rounded as by Blender
    found[:, 1] = size[1] - found[:, 1]
    return found


class Engine(bpy.types.RenderEngine):
    """Fits a field if there is none for the scene, and renders from it."""

    bl_idname = "PHOTON_FIELD"
    bl_label = "Photon Field"
    bl_use_preview = False
    bl_use_shading_nodes_custom = False

    def update_render_passes(self, scene=None, renderlayer=None):
        """The passes besides the picture."""
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        for name, channels, letters, kind in PASSES.values():
            self.register_pass(scene, renderlayer, name, channels, letters, kind)

    def render(self, depsgraph):
        """Render a frame."""
        scene = depsgraph.scene
        camera = scene.camera
        if camera is None or camera.data.type != "PERSP":
            self.report({"ERROR"}, "Photon Field needs a perspective camera.")
            return
        size = [self.resolution_x, self.resolution_y]
        folder = folder_of(scene)
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as work:
            copy = Path(work) / "scene.blend"
            original = bpy.data.scenes[scene.name]
            bpy.data.libraries.write(str(copy), {original}, path_remap="ABSOLUTE")
            request = Path(work) / "request.json"
            settings = original.photon_field
            wanted = {
                "scene": str(copy),
                "field": str(folder / "field.safetensors"),
                "size": size,
                "region": find_region(scene.render, size).tolist(),
                "seconds": settings.seconds,
                "samples": settings.samples,
                "groups": settings.groups,
            }
            request.write_text(json.dumps(wanted), encoding="utf-8")
            if self._run(request):
                self._show(Path(work), depsgraph.view_layer.name)

    def is_stopped(self) -> bool:
        """Whether the user has pressed Esc."""
        return self.test_break()

    def _run(self, request: Path) -> bool:
        """Run `gpf`; whether it made the picture."""
        environment = dict(os.environ)
        for name in ("PYTHONHOME", "PYTHONPATH"):
            environment.pop(name, None)
        environment["GPF_BLENDER"] = bpy.app.binary_path or sys.executable
        environment.update(COMMAND.get("environment", {}))
        errors = request.with_name("errors.txt")
        with errors.open("w") as log:
            process = subprocess.Popen(
                [*COMMAND["command"], str(request)],
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=environment,
            )
        lines: queue.Queue = queue.Queue()
        threading.Thread(target=lambda: [lines.put(s) for s in process.stdout], daemon=True).start()
        try:
            while process.poll() is None:
                if self.is_stopped():
                    return False
                self._tell(lines)
                time.sleep(0.05)
        finally:
            _stop(process)
        self._tell(lines)
        if process.returncode == 0:
            return True
        said = [line for line in errors.read_text(errors="replace").splitlines() if line.strip()]
        self.report({"ERROR"}, said[-1] if said else f"gpf ended with {process.returncode}")
        return False

    def _tell(self, lines: queue.Queue) -> None:
        while not lines.empty():
            word, _, rest = lines.get().strip().partition(" ")
            if word == "gpf:":
                share, _, what = rest.partition(" ")
                self.update_progress(float(share))
                self.update_stats("", f"Photon Field: {what}")

    def _show(self, folder: Path, layer: str) -> None:
        """Give Blender the layers of a picture; its rows begin at the bottom."""
        for name, channels, letters, _ in PASSES.values():
            self.add_pass(name, channels, letters, layer=layer)
        colour = np.load(folder / "radiance.npy")
        result = self.begin_result(0, 0, *colour.shape[1::-1])
        passes = result.layers[0].passes
        alpha = np.ones((*colour.shape[:2], 1), np.float32)
        layers = {"Combined": np.concatenate([colour, alpha], axis=2)}
        for key, (name, channels, _, _) in PASSES.items():
            pixels = np.load(folder / f"{key}.npy")
            layers[name] = pixels.reshape(*colour.shape[:2], channels)
        for name, pixels in layers.items():
            found = passes.get(name)
            if found is not None:
                flat = np.ascontiguousarray(pixels[::-1], np.float32).ravel()
                found.rect.foreach_set(flat)
        self.end_result(result)


def _stop(process) -> None:
    """Have `gpf` end, with time to save its field."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class Panel(bpy.types.Panel):
    """The settings in the render properties."""

    bl_idname = "RENDER_PT_photon_field"
    bl_label = "Photon Field"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {"PHOTON_FIELD"}

    @classmethod
    def poll(cls, context):
        """Whether this engine is chosen."""
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context):
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        for name in ("seconds", "samples", "groups"):
            layout.prop(context.scene.photon_field, name)


CLASSES = (Settings, Engine, Panel)


def _shared_panels():
    """Blender's own panels that suit any engine."""
    unsuitable = {"VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes"}
    for panel in bpy.types.Panel.__subclasses__():
        engines = getattr(panel, "COMPAT_ENGINES", set())
        if "BLENDER_RENDER" in engines and panel.__name__ not in unsuitable:
            yield panel


def register():
    """Add the engine to Blender."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.photon_field = bpy.props.PointerProperty(type=Settings)
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.add(Engine.bl_idname)


def unregister():
    """Take it out again."""
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.discard(Engine.bl_idname)
    del bpy.types.Scene.photon_field
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
