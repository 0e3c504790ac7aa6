"""A scene with its baked light as glTF.

Ratified glTF has no light maps. So surfaces with a diffuse component are black and emit the light
that leaves them, which every viewer shows, in glass and mirrors too (KHR_materials_unlit is for
what cameras see: path tracers show nothing there). Glass and metal are materials of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.baking.albedo import WRAPS, Albedo
from gpf.baking.atlas import Atlas, Chart
from gpf.baking.finish import Finish, look_behind, read_finish, read_gloss, uv_extent
from gpf.baking.glb import Glb, Json
from gpf.baking.reflectance import emitted_by, is_black, rows
from gpf.baking.surfaces import Surface
from gpf.core.images import tone_map
from gpf.core.structs import from_numpy
from gpf.core.vectors import normalise
from gpf.scene.pinhole import find_focal, make_pinhole
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


def write_glb(stage: Stage, picture: np.ndarray, exposure: float) -> bytes:
    """The bytes of a binary glTF file.

    Parameters
    ----------
    picture: the radiance of the atlas, tone mapped, (H, W, 3) uint8.
    exposure: factor for the emission of surfaces that are not in the atlas.
    """
    glb = Glb(GENERATOR)
    texture = glb.texture(picture)
    known: dict[tuple[bool, float | None], int] = {}

    def add(chart: Chart, gloss: float | None) -> int:
        key = chart.surface.two_sided, gloss
        if key not in known:
            known[key] = glb.add("materials", _lit(texture, *key))
        return _add_mesh(glb, chart, {"TEXCOORD_0": glb.vertices(chart.uv)}, known[key])

    return _write(glb, stage, add, exposure)


def write_unlit_glb(stage: Stage, albedos: Mapping[str, Albedo], exposure: float) -> bytes:
    """The bytes of a binary glTF file whose reader brings the light.

    The materials that are to be lit have ``extras``, with the factor of their base colour, and
    their roughness or -1: base colour times light map, on the second coordinates, is π times the
    radiance. Surfaces without an albedo are white. ``exposure``: as for :func:`write_glb`.
    """
    glb = Glb(GENERATOR)
    images: dict[tuple[bytes, str], int] = {}

    def add(chart: Chart, gloss: float | None) -> int:
        surface = chart.surface
        light = glb.vertices(chart.uv)
        coordinates = {"TEXCOORD_0": light, "TEXCOORD_1": light}
        base: Json = {}
        extras = {"baked": True, "factor": [1.0] * 3, "gloss": -1.0 if gloss is None else gloss}
        if (albedo := albedos.get(surface.name)) is not None:
            extras["factor"] = albedo.factor.tolist()
            base["baseColorFactor"] = [*albedo.factor.tolist(), 1.0]
            if albedo.image is not None and albedo.uv is not None:
                key = albedo.image.tobytes(), albedo.wrap
                if key not in images:
                    images[key] = glb.texture(albedo.image, WRAPS[albedo.wrap])
                base["baseColorTexture"] = {"index": images[key]}
                coordinates["TEXCOORD_0"] = glb.vertices(albedo.uv[chart.vertices])
        material: Json = {
            "name": surface.name,
            "doubleSided": surface.two_sided,
            "extras": extras,
            "pbrMetallicRoughness": {**base, "metallicFactor": 0, "roughnessFactor": gloss},
        }
        if gloss is None:
            material["pbrMetallicRoughness"]["roughnessFactor"] = 1
            material["extensions"] = {"KHR_materials_unlit": {}}
        return _add_mesh(glb, chart, coordinates, glb.add("materials", material))

    return _write(glb, stage, add, exposure)


def _write(
    glb: Glb, stage: Stage, add_lit: Callable[[Chart, float | None], int], exposure: float
) -> bytes:
    """The file; ``add_lit`` adds a node for a surface with baked light, and its roughness."""
    nodes = []
    for chart in stage.atlas.charts:
        gloss = read_gloss(chart.surface)
        if gloss is not None and is_black(chart.surface):
            nodes.append(_add_specular(glb, stage, chart.surface, exposure))
        else:
            nodes.append(add_lit(chart, gloss))
    nodes += [_add_specular(glb, stage, surface, exposure) for surface in stage.specular]
    nodes += [_add_camera(glb, view, stage.aspect) for view in stage.cameras]
    root: Json = {"name": "scene", "children": nodes}
    if is_z_up(stage.cameras):
        root["rotation"] = _UPRIGHT
    glb.content["scene"] = glb.add("scenes", {"nodes": [glb.add("nodes", root)]})
    return glb.to_bytes()


def light_from_afar(stage: Stage, width: int, height: int) -> np.ndarray:
    """The radiance of the scene's environment, W/(m² sr), from all directions of glTF, (H, W, 3):
    rows downwards from +y, columns from -x over -z."""
    angle = 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    latitude = np.pi * (0.5 - (np.arange(height)[:, None] + 0.5) / height)
    flat = np.cos(latitude)
    x, y, z = np.broadcast_arrays(
        flat * np.cos(angle), np.sin(latitude) + 0 * angle, flat * np.sin(angle)
    )
    way = (x, -z, y) if is_z_up(stage.cameras) else (x, y, z)
    si = dr.zeros(mi.SurfaceInteraction3f, x.size)
    si.wi = -from_numpy(mi.Vector3f, np.stack(way, axis=-1).reshape(-1, 3).astype(np.float32))
    seen = rows(stage.scene.environment().eval(si), x.size)
    return np.asarray(seen.reshape(*x.shape, 3))


def is_z_up(cameras: Sequence[View]) -> bool:
    """Whether the z axis points upwards in a scene, instead of y as in glTF."""
    return bool(cameras) and bool(np.argmax(np.abs(cameras[0].up)) == 2)


def _lit(texture: int, two_sided: bool, gloss: float | None) -> Json:
    """A black material that emits the light in the texture, and is shiny if ``gloss`` is given."""
    material: Json = {
        "name": "baked" if gloss is None else "baked, glossy",
        "doubleSided": two_sided,
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.0, 0.0, 0.0, 1.0],
            "metallicFactor": 0,
            "roughnessFactor": 1 if gloss is None else gloss,
        },
        "emissiveTexture": {"index": texture},
        "emissiveFactor": [1, 1, 1],
    }
    if gloss is None:  # glTF's other materials reflect 4 %
        material["extensions"] = {"KHR_materials_specular": {"specularFactor": 0}}
    return material


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
        coordinates["TEXCOORD_0"] = glb.vertices((surface.uv - low) / np.maximum(high - low, 1e-9))
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
    every = np.arange(len(surface.points))
    whole = Chart(surface, every, surface.faces, np.zeros((len(every), 2), np.float32))
    return _add_mesh(glb, whole, coordinates, glb.add("materials", material))


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


def _add_mesh(glb: Glb, chart: Chart, coordinates: dict[str, int], material: int) -> int:
    """Add a node with a mesh."""
    surface = chart.surface
    points = surface.points[chart.vertices]
    attributes = {"POSITION": glb.vertices(points, bounds=True), **coordinates}
    if surface.normals is not None:
        normals = normalise(surface.normals[chart.vertices])
        normals[~normals.any(axis=1)] = 0, 0, 1
        attributes["NORMAL"] = glb.vertices(normals)
    primitive = {
        "attributes": attributes,
        "indices": glb.indices(chart.faces),
        "material": material,
    }
    mesh = glb.add("meshes", {"name": surface.name, "primitives": [primitive]})
    return glb.add("nodes", {"name": surface.name, "mesh": mesh})


def _add_camera(glb: Glb, view: View, aspect: float) -> int:
    """Add a node with a camera; it looks along its own -z."""
    # By columns; y points up, and z backwards.
    matrix = (make_pinhole(view, (1, 1)).pose @ np.diag([1, -1, -1, 1])).T
    half = math.atan(0.5 / find_focal(view, (aspect, 1)))
    lens = {"yfov": 2 * half, "aspectRatio": aspect, "znear": 1e-3}
    camera = glb.add("cameras", {"type": "perspective", "name": view.name, "perspective": lens})
    return glb.add(
        "nodes", {"name": view.name, "camera": camera, "matrix": matrix.ravel().tolist()}
    )


def _in_srgb(colours: np.ndarray) -> np.ndarray:
    return np.round(255 * tone_map(colours, 1)).astype(np.uint8)
