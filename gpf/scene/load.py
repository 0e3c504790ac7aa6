"""Load scenes, by name or by file."""

from __future__ import annotations

import re
from pathlib import Path

import mitsuba as mi

from gpf.core.errors import UserError
from gpf.scene.folders import scene_folder
from gpf.scene.inventory import check_scene
from gpf.scene.xml import read_scene_xml


def load_scene(
    name: str, width: int = 256, height: int = 256, root: Path | None = None
) -> mi.Scene:
    """Load a scene by name; see :func:`load_scene_file`."""
    return load_scene_file(scene_folder(name, root) / "scene.xml", width, height)


def load_scene_file(file: Path, width: int = 256, height: int = 256) -> mi.Scene:
    """Load a Mitsuba scene file and check that photon mapping can render it.

    ``width`` and ``height`` become the parameters ``resx`` and ``resy`` if the file uses them. The
    sensors of :func:`gpf.scene.sensors.make_sensor` do not depend on them.

    Loads with ``optimize=False``. The optimisation merges shapes that share a material: their ids
    are lost, and merged rectangles have a wrong bounding box. It saves no measurable time (``path``
    and ``ptracer`` in scenes of 8 to 22 shapes: differences below 3%).

    Raises
    ------
    UserError: the file or one that it refers to is missing, it does not parse, or
        :func:`check_scene` raises.
    """
    document = read_scene_xml(file)
    if missing := document.missing():
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        todo = "Put it there."
        if (file.parent / "build.py").exists():
            build = f"gpf.scene.snapshot.build_scene({file.parent.name!r})"
            todo = f"build.py beside the scene file generates it: call {build}."
        where, path = str(missing[0].place), missing[0].path
        raise UserError(where, f"refers to {path}{more}, which does not exist", todo)
    # Mitsuba raises an error for a parameter that the file does not use.
    sizes = {"resx": width, "resy": height}
    sizes = {key: n for key, n in sizes.items() if key in document.parameters}
    try:
        scene = mi.load_file(str(file), optimize=False, **sizes)
    except RuntimeError as error:
        # Mitsuba's message begins with a line of its own source code.
        what = re.sub(r"^\[[\w.]+:\d+\] ", "", " ".join(str(error).split()))
        raise UserError(str(file), f"does not load: {what}", "Correct the scene file.") from error
    if not isinstance(scene, mi.Scene):
        raise UserError(
            str(file), f"describes a {type(scene).__name__}", "Its outermost tag has to be <scene>."
        )
    check_scene(scene, str(file))
    return scene
