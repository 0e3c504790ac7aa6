"""Scenes by name: finding, building, loading and checking them.

A scene is a folder ``scenes/<name>`` with

- ``scene.xml``: a Mitsuba scene,
- ``views.yaml``: its cameras (:mod:`gpf.views`),
- ``build.py``, where meshes or textures are generated: ``build(folder: Path) -> list[Path]`` writes
  them below ``folder`` and returns what it wrote. A scene without one needs no building.

Mitsuba is imported where it is needed, in whatever variant is set by then.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import tempfile
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpf.errors import UserError
from gpf.materials import inseparable_materials
from gpf.scene_xml import read_scene_xml
from gpf.views import SceneViews, read_views
from gpf.yaml_files import suggest

if TYPE_CHECKING:
    import mitsuba as mi


def scenes_root() -> Path:
    """The folder that holds the scenes.

    ``$GPF_SCENES`` where it is set; else ``scenes`` in the nearest folder, from the current one
    upwards, that has a ``params.yaml`` or a ``scenes/*/scene.xml``.
    """
    chosen = os.environ.get("GPF_SCENES")
    if chosen:
        if not Path(chosen).is_dir():
            raise UserError(
                "GPF_SCENES", f"{chosen} is not a folder", "Set it to one, or unset it."
            )
        return Path(chosen)
    here = Path.cwd()
    for folder in (here, *here.parents):
        root = folder / "scenes"
        if root.is_dir() and ((folder / "params.yaml").exists() or any(root.glob("*/scene.xml"))):
            return root
    raise UserError(
        str(here),
        "neither this folder nor one above it has scenes",
        "Change to the project's folder, or set GPF_SCENES to the folder that holds the scenes.",
    )


def list_scenes(root: Path | None = None) -> list[str]:
    """The names of all scenes below ``root`` (default: :func:`scenes_root`), sorted."""
    folders = [file.parent.name for file in (root or scenes_root()).glob("*/scene.xml")]
    return sorted(name for name in folders if not name.startswith("."))  # half-made ones


def scene_folder(name: str, root: Path | None = None) -> Path:
    """The folder of a scene; a :class:`UserError` where there is no such scene."""
    root = root or scenes_root()
    known = list_scenes(root)
    if name not in known:
        raise UserError(f"scene {name!r}", "does not exist", suggest(name, known, "The scenes are"))
    return root / name


def scene_files(name: str, root: Path | None = None) -> list[Path]:
    """All files that a scene is made of, sorted: also those that are yet to be built."""
    folder = scene_folder(name, root)
    own = [folder / "scene.xml", folder / "views.yaml", folder / "build.py"]
    referred = read_scene_xml(folder / "scene.xml").files()
    found = {file for file in own if file.exists()} | set(referred)
    return sorted(found)


def load_views(name: str, root: Path | None = None) -> SceneViews:
    """The views of a scene; there is at least one training view."""
    return read_views(scene_folder(name, root) / "views.yaml")


def load_scene(
    name: str, width: int = 256, height: int = 256, root: Path | None = None
) -> mi.Scene:
    """Load a scene by name; see :func:`load_scene_file`."""
    return load_scene_file(scene_folder(name, root) / "scene.xml", width, height)


def load_scene_file(file: Path, width: int = 256, height: int = 256) -> mi.Scene:
    """Load a Mitsuba scene file and check that photon mapping can do something with it.

    ``width`` and ``height`` become the file's parameters ``resx`` and ``resy`` where it uses
    them; the sensors that :func:`gpf.sensors.make_sensor` makes do not depend on them.

    Loaded with ``optimize=False``. The optimisation merges shapes that share a material: their ids
    are lost and merged rectangles report a wrong bounding box, and it gains nothing measurable
    (within 3% of each other for ``path`` and ``ptracer`` in scenes of 8 to 22 shapes).

    Raises
    ------
    UserError: the file or one that it refers to is missing, it does not parse, or
    :func:`check_scene` objects.
    """
    import mitsuba as mi

    document = read_scene_xml(file)
    if missing := document.missing():
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        todo = "Put it there."
        if (file.parent / "build.py").exists():
            name = file.parent.name
            todo = (
                f"It is built: run `gpf stage scene --scene {name}` and take "
                f"results/{name}/scene/scene.xml."
            )
        where, path = str(missing[0].place), missing[0].path
        raise UserError(where, f"refers to {path}{more}, which does not exist", todo)
    # Mitsuba takes a parameter that the file does not use for a mistake.
    sizes = {"resx": width, "resy": height}
    sizes = {key: n for key, n in sizes.items() if key in document.parameters}
    try:
        scene = mi.load_file(str(file), optimize=False, **sizes)
    except RuntimeError as error:
        # Mitsuba begins with the line of its own source that noticed.
        what = re.sub(r"^\[[\w.]+:\d+\] ", "", " ".join(str(error).split()))
        raise UserError(str(file), f"does not load: {what}", "Correct the scene file.") from error
    if not isinstance(scene, mi.Scene):
        raise UserError(
            str(file), f"describes a {type(scene).__name__}", "Its outermost tag has to be <scene>."
        )
    check_scene(scene, str(file))
    return scene


def check_scene(scene: mi.Scene, where: str = "scene") -> None:
    """Raise a :class:`UserError` for a scene without emitters or without diffuse surfaces."""
    info = scene_info(scene)
    if info["emitters"]["count"] == 0:
        raise UserError(where, "has no emitters, so there are no photons", "Add a light.")
    if names := inseparable_materials(scene):
        raise UserError(
            where,
            f"has materials of type {', '.join(names)}, whose diffuse part cannot be told apart",
            "Use plastic, roughplastic, or a blendbsdf of diffuse and a conductor.",
        )
    if not any(bsdf["queried"] for bsdf in info["bsdfs"].values()):
        raise UserError(
            where,
            "has no diffuse surface, so no photon can be stored",
            "Give at least one shape a material with a diffuse component.",
        )


def scene_info(scene: mi.Scene) -> dict[str, Any]:
    """What a scene consists of, as plain values.

    Keys: ``bbox`` (``min``, ``max``), ``emitters`` (``count``, ``types``: number by class),
    ``shapes`` (``id``, ``type``, ``bsdf`` each) and ``bsdfs``: for each material in use, by id, its
    ``type``, whether the field is ``queried`` there (it has a diffuse component) and whether paths
    are ``traced`` through it (it has another component). A layered material is both.
    """
    import mitsuba as mi

    lobes = mi.BSDFFlags
    materials = scene_materials(scene)
    names = {id(bsdf): name for name, bsdf in materials.items()}
    shapes = [
        {"id": shape.id(), "type": shape.class_name(), "bsdf": names.get(id(shape.bsdf()))}
        for shape in scene.shapes()
    ]
    bsdfs = {}
    for name, bsdf in materials.items():
        flags = bsdf.flags()
        bsdfs[name] = {
            "type": bsdf.class_name(),
            "queried": bool(mi.has_flag(flags, lobes.Diffuse)),
            "traced": any(
                bool(mi.has_flag(flags, lobe))
                for lobe in (lobes.Glossy, lobes.Delta, lobes.Delta1D, lobes.Null)
            ),
        }
    emitters = scene.emitters()
    bbox = scene.bbox()
    return {
        "bbox": {
            "min": [float(bbox.min[i]) for i in range(3)],
            "max": [float(bbox.max[i]) for i in range(3)],
        },
        "emitters": {
            "count": len(emitters),
            "types": dict(sorted(Counter(emitter.class_name() for emitter in emitters).items())),
        },
        "shapes": shapes,
        "bsdfs": bsdfs,
    }


def scene_materials(scene: mi.Scene) -> dict[str, mi.BSDF]:
    """The materials of all surfaces that a ray can meet, by id, or by a name of their shape's."""
    import mitsuba as mi

    found: dict[str, mi.BSDF] = {}
    # An instance has a material that nothing looks at; the shapes of its group have the real ones.
    groups = [s for s in mi.traverse(scene).hierarchy if isinstance(s, mi.Shape)]
    for shape in dict.fromkeys((*scene.shapes(), *groups)):
        bsdf = shape.bsdf()
        if bsdf is None or shape.class_name() in ("Instance", "ShapeGroupPlugin"):
            continue
        name = bsdf.id() or f"{bsdf.class_name()} of {shape.id() or shape.class_name()}"
        number, plain = 1, name
        while found.get(name, bsdf) is not bsdf:
            number += 1
            name = f"{plain} ({number})"
        found[name] = bsdf
    return found


def build_scene(name: str, root: Path | None = None, target: Path | None = None) -> list[Path]:
    """Run a scene's ``build.py``, if it has one, and return the files that it made.

    They go below ``target``, by default the scene's own folder. The builder works in a temporary
    folder; a file goes to its place once all are complete.
    """
    folder = scene_folder(name, root)
    target = target or folder
    script = folder / "build.py"
    if not script.exists():
        return []
    spec = importlib.util.spec_from_file_location(f"scene_builder_{name}", script)
    assert spec is not None and spec.loader is not None  # the path ends in .py
    module = importlib.util.module_from_spec(spec)
    staging = Path(tempfile.mkdtemp(dir=target, prefix=".build-"))
    try:
        spec.loader.exec_module(module)
        if not hasattr(module, "build"):
            raise UserError(str(script), "has no function build", "Define build(folder: Path).")
        made = []
        for source in module.build(staging):
            place = target / source.relative_to(staging)
            place.parent.mkdir(parents=True, exist_ok=True)
            os.replace(source, place)
            made.append(place)
        return made
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def freeze_scene(name: str, target: Path, root: Path | None = None) -> None:
    """Make ``target`` a complete copy of a scene: its files, and what its builder generates.

    Nothing else remains in ``target``. The files of :func:`scene_files` other than the builder are
    copied, so that a frozen scene depends on no other folder. It is loaded once before it takes the
    place of an older one: a :class:`UserError` leaves that as it was.
    """
    folder = scene_folder(name, root)
    target.parent.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(dir=target.parent, prefix=".freeze-"))
    try:
        made = {p.relative_to(staging) for p in build_scene(name, root, staging)}
        references = read_scene_xml(folder / "scene.xml").references
        lines = {reference.path: str(reference.place) for reference in reversed(references)}
        for source in scene_files(name, root):
            if not source.resolve().is_relative_to(folder.resolve()):
                raise UserError(
                    lines.get(source, str(folder / "scene.xml")),
                    f"refers to {source}, which is outside of the scene's folder",
                    "Copy it into the folder and refer to it by a relative path.",
                )
            if source.name == "build.py" or source.relative_to(folder) in made:
                continue
            if not source.exists():
                raise UserError(
                    lines.get(source, str(folder / "scene.xml")),
                    f"refers to {source}, which does not exist",
                    "Put it there, or correct the scene file.",
                )
            place = staging / source.relative_to(folder)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, place)
        make_folders(folder / "scene.xml", staging)
        try:
            views = read_views(staging / "views.yaml")
            load_scene_file(staging / "scene.xml", *views.size(16))
        except UserError as error:  # what there was before stays
            where, what = (t.replace(str(staging), str(folder)) for t in (error.where, error.what))
            raise UserError(where, what, error.todo) from None
        shutil.rmtree(target, ignore_errors=True)
        os.replace(staging, target)
        target.chmod(0o755)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def make_folders(file: Path, target: Path) -> None:
    """Make the folders below ``target`` that a scene file expects, even if they stay empty."""
    for reference in read_scene_xml(file).references:
        if reference.is_folder and reference.path.is_relative_to(file.parent):
            (target / reference.path.relative_to(file.parent)).mkdir(parents=True, exist_ok=True)
