"""A scene with its baked light as glTF.

Ratified glTF has no light maps. So surfaces with a diffuse component have the light that leaves
them as a picture, and the material says that this is already so: KHR_materials_unlit, or emission
for those that are glossy as well. Glass and metal are materials of their own, which show what a
viewer has around them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from gpf.baking.atlas import Atlas
from gpf.baking.finish import Finish, look_behind, read_finish, read_gloss, uv_extent
from gpf.baking.glb import Glb, Json
from gpf.baking.reflectance import emitted_by, is_black
from gpf.baking.surfaces import Surface
from gpf.core.images import tone_map
from gpf.scene.views import View

GENERATOR = "Gaussian Photon Fields"

# At which z axis points upwards, the rotation that lets y do so, as glTF has it.
_UPRIGHT = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]


@dataclass(frozen=True)
class Stage:
    """What a file shows.

    Attributes
    ----------
    atlas: the surfaces that light is baked on.
    specular: all other surfaces.
    cameras: the first one is where viewers start.
    aspect: width divided by height of their pictures.
    """

    scene: mi.Scene
    atlas: Atlas
    specular: Sequence[Surface]
    cameras: Sequence[View]
    aspect: float


def write_stage(stage: Stage, picture: np.ndarray | None, exposure: float) -> bytes:
    """The bytes of a binary glTF file.

    Parameters
    ----------
    picture: the radiance of the atlas, tone mapped, (H, W, 3) uint8; None for a file whose reader
        brings it: the materials' ``extras`` say which ones show it.
    exposure: factor for the emission of surfaces that are not in the atlas.
    """
    glb = Glb(GENERATOR)
    texture = None if picture is None else glb.texture(picture)
    known: dict[tuple[bool, float | None], int] = {}
    nodes = []
    for chart in stage.atlas.charts:
        surface, gloss = chart.surface, read_gloss(chart.surface)
        if gloss is not None and is_black(surface):
            nodes.append(_add_specular(glb, stage, surface, exposure))
            continue
        key = surface.two_sided, gloss
        if key not in known:
            known[key] = glb.add("materials", _lit(texture, *key))
        uv = {"TEXCOORD_0": glb.vertices(chart.uv)}
        nodes.append(_add_mesh(glb, surface, chart.vertices, chart.faces, uv, known[key]))
    nodes += [_add_specular(glb, stage, surface, exposure) for surface in stage.specular]
    nodes += [_add_camera(glb, view, stage.aspect) for view in stage.cameras]
    root: Json = {"name": "scene", "children": nodes}
    if is_z_up(stage.cameras):
        root["rotation"] = _UPRIGHT
    glb.content["scene"] = glb.add("scenes", {"nodes": [glb.add("nodes", root)]})
    return glb.to_bytes()


def is_z_up(cameras: Sequence[View]) -> bool:
    """Whether the z axis points upwards in a scene, instead of y as in glTF."""
    return bool(cameras) and bool(np.argmax(np.abs(cameras[0].up)) == 2)


def _lit(texture: int | None, two_sided: bool, gloss: float | None) -> Json:
    """A material that shows the light in the texture; with the viewer's reflections if glossy."""
    shown = {} if texture is None else {"index": texture}
    black = [0.0, 0.0, 0.0, 1.0]
    material: Json = {"name": "baked", "doubleSided": two_sided, "extras": {"baked": True}}
    if gloss is None:
        plain = {"baseColorTexture": shown} if shown else {}
        material["pbrMetallicRoughness"] = {**plain, "metallicFactor": 0, "roughnessFactor": 1}
        return {**material, "extensions": {"KHR_materials_unlit": {}}}
    coat = {"baseColorFactor": black, "metallicFactor": 0, "roughnessFactor": gloss}
    light = {"emissiveTexture": shown, "emissiveFactor": [1, 1, 1]} if shown else {}
    return {**material, "name": "baked, glossy", "pbrMetallicRoughness": coat, **light}


def _add_specular(glb: Glb, stage: Stage, surface: Surface, exposure: float) -> int:
    """Add a node for a surface of glass or metal."""
    finish = read_finish(surface)
    colour = finish.colour
    extensions: Json = {}
    if finish.transmits:
        colour, extensions = _glass(finish, stage.scene, surface)
    coordinates = {}
    if colour.ndim == 3:
        low, high = uv_extent(surface)
        assert surface.uv is not None
        coordinates["TEXCOORD_0"] = glb.vertices((surface.uv - low) / (high - low))
    base = (
        {"baseColorTexture": {"index": glb.texture(_in_srgb(colour))}}
        if coordinates
        else {"baseColorFactor": [*colour.tolist(), 1.0]}
    )
    material: Json = {
        "name": surface.shape.bsdf().id() or surface.name,
        "doubleSided": surface.two_sided and not finish.bends,
        "pbrMetallicRoughness": {
            **base,
            "metallicFactor": 0 if finish.transmits else 1,
            "roughnessFactor": finish.roughness,
        },
    }
    if surface.shape.is_emitter():
        light = exposure * emitted_by(surface)
        strength = max(float(light.max()), 1.0)
        material["emissiveFactor"] = (light / strength).tolist()
        material["extras"] = {"lamp": surface.name}
        extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
    if extensions:
        material["extensions"] = extensions
    everything = np.arange(len(surface.points))
    added = glb.add("materials", material)
    return _add_mesh(glb, surface, everything, surface.faces, coordinates, added)


def _glass(finish: Finish, scene: mi.Scene, surface: Surface) -> tuple[np.ndarray, Json]:
    """The colour and the extensions of glass."""
    extensions: Json = {"KHR_materials_transmission": {"transmissionFactor": 1}}
    if not finish.bends:
        return finish.colour, extensions
    distance, ends = look_behind(scene, surface)
    extensions["KHR_materials_ior"] = {"ior": finish.ior}
    # A viewer bends what it sees at this distance behind the surface.
    extensions["KHR_materials_volume"] = {"thicknessFactor": distance}
    # Light that comes out of water spreads: its radiance falls. Through a pane, it is restored.
    return finish.colour * (ends / finish.ior**2 + 1 - ends), extensions


def _add_mesh(
    glb: Glb,
    surface: Surface,
    vertices: np.ndarray,
    faces: np.ndarray,
    coordinates: dict[str, int],
    material: int,
) -> int:
    """Add a node with a mesh; ``vertices``: indices of the surface's points, (V,)."""
    attributes = {"POSITION": glb.vertices(surface.points[vertices], bounds=True), **coordinates}
    if surface.normals is not None:
        attributes["NORMAL"] = glb.vertices(_unit(surface.normals[vertices]))
    primitive = {"attributes": attributes, "indices": glb.indices(faces), "material": material}
    mesh = glb.add("meshes", {"name": surface.name, "primitives": [primitive]})
    return glb.add("nodes", {"name": surface.name, "mesh": mesh})


def _add_camera(glb: Glb, view: View, aspect: float) -> int:
    """Add a node with a camera; it looks along its own -z."""
    back = _unit(np.subtract(view.origin, view.target))
    right = _unit(np.cross(view.up, back))
    axes = np.stack([right, np.cross(back, right), back, np.array(view.origin)])
    matrix = np.hstack([axes, [[0], [0], [0], [1]]])
    # The extent across which the angle is measured, in heights of the picture.
    wide = {"x": aspect, "y": 1.0, "diagonal": math.hypot(aspect, 1)}
    wide |= {"smaller": min(aspect, 1.0), "larger": max(aspect, 1.0)}
    half = math.tan(math.radians(view.fov) / 2) / wide[view.fov_axis]
    lens = {"yfov": 2 * math.atan(half), "aspectRatio": aspect, "znear": 1e-3}
    camera = glb.add("cameras", {"type": "perspective", "name": view.name, "perspective": lens})
    return glb.add(
        "nodes", {"name": view.name, "camera": camera, "matrix": matrix.ravel().tolist()}
    )


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), [0, 0, 1])


def _in_srgb(colours: np.ndarray) -> np.ndarray:
    return np.round(255 * tone_map(colours, 1)).astype(np.uint8)
