"""Read a scene with Blender, and write it in plain values: JSON, meshes, and arrays.

    python read.py FILE FOLDER [FRAMES]   # a Python with the package bpy
    blender -b --factory-startup --python read.py -- FILE FOLDER [FRAMES]

FILE is a ``.blend`` file, or one that Blender imports. Scripts and drivers in it are not run. Each
line on standard output that begins with ``gpf:`` says what is being done; ``gpf-error:`` comes
before an error of the file.

Without FRAMES, ``scene.json`` has the scene as it was saved. FRAMES is "all", or FIRST:LAST for
FIRST to LAST-1, from 0. Then ``frame_0001.json`` and so on, by Blender's numbers, have the scene in
these frames, and ``frames.json`` has the numbers of all frames that there are. If FRAMES does not
fit these, nothing else is written.
"""

from __future__ import annotations

import json
import math
import re
import sys
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import bpy
from cameras import frame_numbers
from named_files import named_files
from reader import Reader


class Unreadable(Exception):
    """What is wrong with the file."""


def tell(what: str) -> None:
    """Say what is being done."""
    print(f"gpf: {what}", flush=True)


def open_file(file: Path) -> None:
    """Open or import a file as the current scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    kind = file.suffix.lower()
    openers: dict[str, Any] = {
        ".blend": lambda path: bpy.ops.wm.open_mainfile(
            filepath=path, load_ui=False, use_scripts=False
        ),
        ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
        ".gltf": lambda path: bpy.ops.import_scene.gltf(filepath=path),
        ".fbx": lambda path: bpy.ops.wm.fbx_import(filepath=path),
        ".obj": lambda path: bpy.ops.wm.obj_import(filepath=path),
    }
    for suffix in (".usd", ".usda", ".usdc", ".usdz"):
        openers[suffix] = lambda path: bpy.ops.wm.usd_import(filepath=path)
    try:
        openers[kind](str(file))
    except RuntimeError as error:
        lines = (line.strip() for line in str(error).splitlines())
        words = [line for line in lines if line and not line.startswith("Location:")]
        first = words[0].removeprefix("Error:").strip() if words else "cannot be opened"
        raise Unreadable(words[-1] if "Traceback" in first else first) from None
    if kind in (".glb", ".gltf", ".fbx", ".obj"):
        set_range(bpy.context.scene)
        for lamp in bpy.data.lights:
            if lamp.type == "SUN":  # these formats have none with a size
                lamp.angle = 0
    version = tuple(bpy.data.version)[:2]
    if kind == ".blend" and version > bpy.app.version[:2]:
        tell(f"note: the file is of Blender {version[0]}.{version[1]}, newer than this one")


def set_range(scene: Any) -> None:
    """Let a scene have the frames of its actions; these formats name none."""
    ranges = [action.frame_range for action in bpy.data.actions] or [(1, 1)]
    scene.frame_start = max(math.floor(min(first for first, _ in ranges)), 0)
    scene.frame_end = math.ceil(max(last for _, last in ranges))


def make_local() -> list[str]:
    """Make what comes from linked libraries editable; names of those that are missing."""
    missing = [
        lib.filepath
        for lib in bpy.data.libraries
        if not Path(bpy.path.abspath(lib.filepath)).is_file()
    ]
    if bpy.data.libraries:
        bpy.ops.object.make_local(type="ALL")
    return missing


def read(file: Path, folder: Path, frames: str | None) -> None:
    """Read a file, and write everything into a folder."""
    tell("opening")
    open_file(file)
    missing = make_local()
    scene = bpy.context.scene
    for name in ("meshes", "textures"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    reader = Reader(scene, folder, missing, tell)
    reader.files = named_files(file)
    if frames is None:
        reader.write("scene")
    else:
        read_frames(reader, scene, frames)
    tell("done")


def read_frames(reader: Reader, scene: Any, frames: str) -> None:
    """Write some frames of a scene, and the first one: with what was baked there, and with faces
    cut as there, others are the same whichever are wanted."""
    numbers = frame_numbers(scene)
    wanted = chosen(frames, numbers)
    wanted = wanted and [numbers[0], *wanted]
    # Through all frames: in a simulation, each comes from the one before.
    for number in range(numbers[0], max(wanted, default=numbers[0] - 1) + 1):
        reader.tell = partial(tell_in_frame, number)
        scene.frame_set(number)
        if number in wanted:
            reader.write(f"frame_{number:04}", number)
    found = {"numbers": numbers, "notes": reader.repeated()}
    (reader.folder / "frames.json").write_text(json.dumps(found), encoding="utf-8")


def tell_in_frame(number: int, what: str) -> None:
    """Say what is being done in a frame."""
    tell(f"frame {number}: {what}")


def chosen(frames: str, numbers: list[int]) -> list[int]:
    """The frames that are asked for; none if there are no such frames."""
    found = re.fullmatch(r"(\d*):(\d*)", ":" if frames == "all" else frames)
    first, last = (int(found[1] or 0), int(found[2] or len(numbers))) if found else (0, 0)
    return numbers[first:last] if last <= len(numbers) else []


def main(words: list[str]) -> int:
    """The program."""
    file, folder = (Path(word).resolve() for word in words[:2])
    try:
        read(file, folder, words[2] if len(words) > 2 else None)
    except Unreadable as error:
        print(f"gpf-error: {error}", flush=True)
        return 2
    return 0


if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    sys.exit(main(arguments))
