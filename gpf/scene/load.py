"""Load scenes, by name or by file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import mitsuba as mi

from gpf.core.errors import UserError
from gpf.scene.folders import scene_folder
from gpf.scene.inventory import check_scene
from gpf.scene.materials import INSEPARABLE
from gpf.scene.xml import read_scene_xml

# Plugins of Mitsuba -> plugins of this project that are loaded in their place.
REPLACED = {name: f"separable_{name}" for name in INSEPARABLE.values()}


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
        scene = _load(file, sizes)
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


def _load(file: Path, parameters: dict[str, int]) -> Any:
    """What ``mi.load_file`` loads, with the project's plugins in place of some of Mitsuba's."""
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_equivalent = config.merge_meshes = False
    values = {key: str(value) for key, value in parameters.items()}
    before = mi.file_resolver()
    resolver = mi.FileResolver(before)
    resolver.prepend(str(file.parent))
    mi.set_file_resolver(resolver)
    state = None
    try:
        state = mi.parser.parse_file(config, str(file), **values)
        mi.parser.transform_all(config, state)
        _use_own_plugins(state)
        loaded = mi.parser.instantiate(config, state)
    finally:
        mi.set_file_resolver(before)
        # If a shape fails, the others are freed, but `state` keeps their emitters, and the
        # traceback keeps `state`: the next kernel that calls emitters would end the process.
        del state
    return loaded[0] if isinstance(loaded, list) and len(loaded) == 1 else loaded


def _use_own_plugins(state: mi.parser.ParserState) -> None:
    """Put the project's plugins in the place of some of Mitsuba's."""
    for node in state.nodes:
        name = node.props.plugin_name()
        node.props.set_plugin_name(REPLACED.get(name, name))
