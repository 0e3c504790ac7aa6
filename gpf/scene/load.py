"""Load scenes by name or by file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mitsuba as mi

from gpf.core.errors import UserError
from gpf.core.runtime import two_threads
from gpf.scene.folders import scene_folder
from gpf.scene.frames import SceneFrame
from gpf.scene.grids import check_grid
from gpf.scene.inventory import check_scene
from gpf.scene.materials import INSEPARABLE
from gpf.scene.meshes import check_obj, check_ply, check_serialized
from gpf.scene.xml import SceneXml, read_scene_xml

# Mitsuba's plugins -> this project's plugins, loaded in their place.
REPLACED = {name: f"separable_{name}" for name in INSEPARABLE.values()}

OLD = (
    "In old scenes, Mitsuba 3 renames only the parameters: write <lookat> for <lookAt>, <rgb> for "
    "<srgb>, hdrfilm for ldrfilm, independent for sobol, bilinear for trilinear, and so on."
)
"""What to do if Mitsuba rejects a scene of version 0.5 or 0.6."""


def load_scene(
    name: str, width: int = 256, height: int = 256, root: Path | None = None
) -> mi.Scene:
    """Load a scene by name; see :func:`load_scene_file`."""
    return load_scene_file(scene_folder(name, root) / "scene.xml", width, height)


def load_frame(frame: SceneFrame) -> mi.Scene:
    """Load a frame of an animation; see :func:`load_scene_file`."""
    return load_scene_file(frame.file, parameters=frame.parameters)


def load_scene_file(
    file: Path | str,
    width: int = 256,
    height: int = 256,
    parameters: Mapping[str, str] | None = None,
) -> mi.Scene:
    """Load a Mitsuba scene file and check that photon mapping can render it.

    ``width`` and ``height`` become the parameters ``resx`` and ``resy`` if the file uses them. The
    sensors of :func:`gpf.scene.sensors.make_sensor` do not depend on them. ``parameters``: values
    of further parameters, by name.

    The scene is loaded without its integrator, which may be a plugin that is not installed, or
    somebody else's ``sppm``. Its id is the file's name or, of a ``scene.xml``, the folder's.

    Loads with ``optimize=False``. The optimisation merges shapes that share a material: their ids
    are lost, and merged rectangles get a wrong bounding box. It saves no measurable time (``path``
    and ``ptracer`` in scenes of 8 to 22 shapes: differences below 3%).

    Raises
    ------
    UserError: the file or one that it refers to is missing, it does not parse, or
        :func:`check_ply`, :func:`check_serialized`, :func:`check_obj`, :func:`check_grid` or
        :func:`check_scene` raises.
    """
    file = Path(file)
    document = check_files(file, parameters)
    # Mitsuba raises an error for a parameter that the file does not use.
    sizes = {"resx": width, "resy": height}
    sizes = {key: n for key, n in sizes.items() if key in document.parameters}
    scene = load_with_parameters(file, sizes | dict(parameters or {}), integrator=False)
    check_scene(scene, str(file))
    scene.set_id(file.absolute().parent.name if file.stem == "scene" else file.stem)
    return scene


def check_files(file: Path, parameters: Mapping[str, str] | None = None) -> SceneXml:
    """Check a scene file and the files that it names before Mitsuba reads them.

    ``parameters``: values of parameters, by name, instead of the file's own.

    Raises
    ------
    UserError: as :func:`load_scene_file`.
    """
    document = read_scene_xml(file, parameters)
    if missing := document.missing():
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        todo = "Put it there."
        if (file.parent / "build.py").exists():
            build = f"gpf.scene.snapshot.build_scene({file.parent.name!r})"
            todo = f"build.py beside the scene file generates it: call {build}."
        if "\\" in missing[0].text:
            todo = "Separate folders with / instead of \\."
        where, path = str(missing[0].place), missing[0].path
        raise UserError(where, f"refers to {path}{more}, which does not exist", todo)
    for path, reference in {r.path: r for r in reversed(document.references)}.items():
        if path.is_file():
            for check in (check_ply, check_serialized, check_obj, check_grid):
                check(path, str(reference.place))
    return document


def load_with_parameters(
    file: Path, parameters: Mapping[str, object], integrator: bool = True
) -> mi.Scene:
    """Load a file like ``mi.load_file``, with some of Mitsuba's plugins replaced by this project's.

    ``integrator``: whether to load the scene's own integrator too.

    Raises
    ------
    UserError: Mitsuba cannot load the file, the file contains no scene, or a plugin is not one of
        Mitsuba's or would kill the process.
    """
    try:
        scene = _load(file, parameters, integrator)
    except (RuntimeError, UnicodeDecodeError) as error:
        what = describe_plugin_error(error)
        raise UserError(str(file), f"does not load: {what}", _advise(file)) from error
    if not isinstance(scene, mi.Scene):
        raise UserError(
            str(file), f"describes a {type(scene).__name__}", "Its outermost tag must be <scene>."
        )
    return scene


def _advise(file: Path) -> str:
    versions = [tag.attributes.get("version", "") for tag in read_scene_xml(file).tags]
    old = any(version.startswith(("0.", "1.")) for version in versions)
    return f"Correct the scene file.{f' {OLD}' if old else ''}"


def describe_plugin_error(error: BaseException) -> str:
    """The message of an error from Mitsuba or a plugin, in one line for users."""
    while error.__cause__ and "(see above)" in str(error):  # Dr.Jit wraps errors in its loops
        error = error.__cause__
    said = str(error)
    if isinstance(error, UnicodeDecodeError):  # Mitsuba's message quotes bytes of a damaged file
        said = error.object.decode(errors="replace")
    # Plugins in Python, such as this project's, add a traceback to the message.
    what = re.sub(r"Traceback \(most.*:\s*\n([ \t]+.*\n)*([\w.]+: )?", "", said)
    # Mitsuba's messages contain line numbers of its own source code.
    return re.sub(r"\[[\w.]+:\d+\] ", "", " ".join(what.split())).rstrip(".")


def _load(file: Path, parameters: Mapping[str, object], integrator: bool) -> Any:
    """Load what the file describes; errors are in Mitsuba's words."""
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
        _refuse_foreign_code(state)
        _require_parts(state)
        _use_own_plugins(state)
        if not integrator:
            _leave_out_integrators(state)
        with two_threads():
            loaded = mi.parser.instantiate(config, state)
    finally:
        mi.set_file_resolver(before)
        # If a shape fails, the others are freed, but `state` keeps their emitters alive, and
        # the traceback keeps `state`: the next kernel that calls emitters would kill the process.
        del state
    return loaded[0] if isinstance(loaded, list) and len(loaded) == 1 else loaded


def _refuse_foreign_code(state: mi.parser.ParserState) -> None:
    """Raise a :class:`UserError` if a folder that Mitsuba searches (the scene's or the current one)
    has a subfolder `plugins` with libraries: Mitsuba would load those instead of its own plugins,
    or along with them, and loading a library runs it."""
    for node in state.nodes:
        if {"/", "\\"} & {*node.props.plugin_name()}:
            where = mi.parser.file_location(state, node)
            raise UserError(where, "has a type that is a path", "Correct the scene file.")
    own = Path(mi.__file__).resolve().parent
    for folder in mi.file_resolver():
        for library in Path(str(folder)).glob("plugins/*"):
            library = library.resolve()
            if library.suffix in (".so", ".dylib", ".dll") and not library.is_relative_to(own):
                raise UserError(
                    str(library),
                    "would be run by Mitsuba as a plugin",
                    "Move it away: scenes may only use Mitsuba's own plugins.",
                )


def _require_parts(state: mi.parser.ParserState) -> None:
    """Raise a :class:`UserError` if a plugin lacks a part and Mitsuba would crash instead of
    reporting it."""
    for node in state.nodes:
        props, name = node.props, node.props.plugin_name()
        if name == "blendbsdf":
            needed, found = "materials", bool(_parts(props))
        elif name == "bitmap":
            needed, found = "filename", bool({"filename", "data", "bitmap"} & {*props.keys()})
        else:
            continue
        if not found:
            where = mi.parser.file_location(state, node)
            raise UserError(where, f"is a {name} without {needed}", "Correct the scene file.")


def _use_own_plugins(state: mi.parser.ParserState) -> None:
    """Replace some of Mitsuba's plugins by this project's, and let environment maps emit all of
    their light (:func:`gpf.scene.inventory.loses_dim_sky`)."""
    for node in state.nodes:
        name = node.props.plugin_name()
        node.props.set_plugin_name(REPLACED.get(name, name))
        if name == "envmap" and "mis_compensation" in node.props:
            del node.props["mis_compensation"]


def _leave_out_integrators(state: mi.parser.ParserState) -> None:
    """Remove references to integrators: Mitsuba creates only what the scene refers to."""
    for node in state.nodes:
        for key in _parts(node.props):
            if state.nodes[node.props[key].index()].type == mi.ObjectType.Integrator:
                del node.props[key]


def _parts(props: mi.Properties) -> list[str]:
    """The names of the properties that are other nodes.

    Found by type: reading a value marks it as used, so Mitsuba would accept misspelt names.
    """
    return [key for key in props if props.type(key) == mi.Properties.Type.ResolvedReference]
