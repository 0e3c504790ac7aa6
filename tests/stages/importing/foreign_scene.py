"""A scene as somebody else would have made it, and the call that imports it."""

from __future__ import annotations

import zipfile
from pathlib import Path

import mitsuba as mi
import numpy as np

from gpf.scene.views import SceneViews, View, ViewSets
from stages.importing.importer import ImportReport, import_scene

SCENE = """\
<?xml version="1.0" encoding="utf-8"?>
<scene version="3.0.0">
    <default name="resx" value="9"/>
    <default name="resy" value="6"/>
    <default name="mesh" value="models/wedge"/>
    <path value="textures"/>
    <sensor type="perspective" id="Main Camera">
        <float name="fov" value="50"/>
        <transform name="to_world">
            <lookat origin="0.5, 1.5, 4" target="0, 0.25, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="$resx"/>
            <integer name="height" value="$resy"/>
        </film>
    </sensor>
    <include filename="parts/light.xml"/>
    <bsdf type="twosided" id="Floor">
        <bsdf type="diffuse">
            <texture name="reflectance" type="bitmap">
                <string name="filename" value="wood.png"/>
            </texture>
        </bsdf>
    </bsdf>
    <shape type="rectangle" id="Ground">
        <transform name="to_world"><rotate x="1" angle="-90"/><scale value="3"/></transform>
        <ref id="Floor"/>
    </shape>
    <shape type="ply" id="Wedge">
        <string name="filename" value="$mesh.ply"/>
        <bsdf type="diffuse" id="Green"><spectrum name="reflectance" filename="green.spd"/></bsdf>
    </shape>
    <shape type="sphere" id="Ball">
        <point name="center" x="1" y="0.5" z="1"/><float name="radius" value="0.4"/>
        <bsdf type="dielectric" id="Glass"/>
    </shape>
</scene>
"""
LIGHT = """\
<scene version="3.0.0">
    <emitter type="point" id="Lamp"><point name="position" x="0" y="3" z="0"/></emitter>
</scene>
"""
MESH = """\
ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
-1 0 0
1 0 0
0 1 -0.5
3 0 1 2
"""


def write_original(folder: Path) -> Path:
    """Make the folder: the scene, what it refers to, a licence, and a file that nobody needs."""
    for name in ("parts", "models", "textures"):
        (folder / name).mkdir(parents=True)
    (folder / "scene.xml").write_text(SCENE)
    (folder / "parts/light.xml").write_text(LIGHT)
    (folder / "models/wedge.ply").write_text(MESH)
    (folder / "models/unused.ply").write_text(MESH)
    (folder / "green.spd").write_text("400 0.1\n550 0.8\n700 0.1\n")
    (folder / "LICENSE.txt").write_text("Do as you like.\n")
    texture = np.linspace(0, 1, 4 * 3 * 3, dtype=np.float32).reshape(3, 4, 3)
    mi.util.write_bitmap(str(folder / "textures/wood.png"), texture, write_async=False)
    return folder


def place_two(scene: mi.Scene, own: list[View], aspect: float) -> SceneViews:
    """The scene's own cameras, and the first one a step aside."""
    x, y, z = own[0].origin
    aside = own[0].model_copy(update={"name": "aside", "origin": (x - 0.5, y, z)})
    return SceneViews(views=ViewSets(train=tuple(own), novel=(aside,)), aspect=aspect)


def bring(path: Path, root: Path, name: str = "room") -> ImportReport:
    """Import it, with few photons."""
    return import_scene(path, name, place_two, root, photons=2000)


def pack(folder: Path, archive: Path) -> Path:
    """A zip archive of the folder, its name included."""
    with zipfile.ZipFile(archive, "w") as opened:
        for file in sorted(folder.rglob("*")):
            opened.write(file, file.relative_to(folder.parent).as_posix())
    return archive


def files_of(folder: Path) -> list[str]:
    """Every file below the folder."""
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
