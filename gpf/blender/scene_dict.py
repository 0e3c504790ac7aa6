"""What Blender wrote about a scene, as a dictionary for Mitsuba, and its cameras."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.blender.closures import Material
from gpf.blender.lights import emitters, sky, suns_with_an_angle
from gpf.blender.materials import translate
from gpf.blender.textures import Textures

Dict = dict[str, Any]


@dataclass
class Translation:
    """A scene for Mitsuba.

    Attributes
    ----------
    scene: for `mi.load_dict`; files are relative to the scene's folder.
    how: for each material, "exact", "baked" or what is approximated.
    notes: what is left out or approximated elsewhere.
    """

    scene: Dict
    how: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    _taken: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(("type", "id", "integrator"), 1)
    )

    def label(self, name: str) -> str:
        """A name for a part of the scene, different from all before."""
        plain = re.sub(r"\W", "_", name, flags=re.ASCII)
        plain = plain if plain[:1].isalpha() else f"part_{plain}"
        name, number = plain, self._taken.get(plain.lower(), 0)
        while name.lower() in self._taken:
            number += 1
            name = f"{plain}_{number}"
        self._taken[plain.lower()] = number
        self._taken[name.lower()] = 1
        return name


def translate_scene(found: Mapping[str, Any], textures: Textures) -> Translation:
    """Translate a description.

    Parameters
    ----------
    found: ``scene.json`` of ``program/read.py``.
    textures: its images. They write those that Mitsuba needs.
    """
    result = Translation({"type": "scene", "integrator": {"type": "path", "max_depth": 32}})
    result.notes += found["notes"]
    for name, sensor in cameras(found, result.notes).items():
        result.scene[result.label(name)] = sensor
    materials = _Materials(found, textures, result)
    for shape in found["shapes"]:
        result.scene[result.label(shape["name"])] = _shape(shape, materials)
    for key, shapes in found["groups"].items():
        name = result.label("group")
        group: Dict = {"type": "shapegroup", "id": name}
        for shape in shapes:
            group[result.label(shape["name"])] = _shape(shape, materials)
        result.scene[name] = group
        for instance in (i for i in found["instances"] if i["group"] == key):
            result.scene[result.label(f"{name}_copy")] = {
                "type": "instance",
                "to_world": mi.ScalarTransform4f(np.array(instance["matrix"])),
                "group": {"type": "ref", "id": name},
            }
    for name, made in emitters(found["lamps"], result.notes).items():
        result.scene[result.label(name)] = made
    origin = found["world"], found["lamps"]
    file = textures.sky_file(found["world"], suns_with_an_angle(found["lamps"]))
    for name, made in sky(*origin, textures.work, textures.folder, file).items():
        result.scene[result.label(name)] = made
    result.notes += [f"image missing: {name}" for name in found["missing_images"]]
    result.notes += [f"library missing: {name}" for name in found["missing_libraries"]]
    return result


class _Materials:
    """The BSDFs of a scene: one for each closure, which objects share."""

    def __init__(self, found: Mapping[str, Any], textures: Textures, result: Translation) -> None:
        self.textures, self.result = textures, result
        self._closures = {(c["mesh"], c["slot"]): c["closure"] for c in found["closures"]}
        self._made: dict[str, tuple[Material, str]] = {}

    def find(self, shape: Mapping[str, Any]) -> tuple[Material, str]:
        """The material of a shape, and the id of its BSDF in the scene."""
        closure = self._closures[shape["mesh"], shape["slot"]]
        key = f"{shape['material']} {closure}"
        if key not in self._made:
            name = shape["material"] or "no material"
            label = self.result.label(f"material_{name}")
            made = translate(closure, self.textures)
            self.result.scene[label] = made.whole() | {"id": label}
            if made.medium is not None:
                medium = self.result.label(f"medium_{name}")
                self.result.scene[medium] = made.medium | {"id": medium}
                made.medium = {"type": "ref", "id": medium}
            baked = "baked" if "'array'" in str(closure) else "exact"
            self.result.how[name] = "; ".join(dict.fromkeys(made.notes)) or baked
            self._made[key] = made, label
        return self._made[key]


def _shape(shape: Mapping[str, Any], materials: _Materials) -> Dict:
    """The shape of a mesh."""
    material, label = materials.find(shape)
    made: Dict = {"type": "ply", "filename": shape["file"], "bsdf": {"type": "ref", "id": label}}
    if material.emission is not None:
        made["emitter"] = {"type": "area", "radiance": material.emission}
    if material.medium is not None:
        made["interior"] = material.medium
    return made


def cameras(found: Mapping[str, Any], notes: list[str]) -> Dict:
    """Sensors by name, the scene's own first; other kinds than perspective ones are left out."""
    sensors = {}
    width, height = found["size"]
    for camera in found["cameras"]:
        if camera["type"] != "PERSP":
            notes.append(f"camera {camera['name']}: {camera['type'].lower()} camera left out")
            continue
        if camera["blurred"]:
            notes.append(f"camera {camera['name']}: depth of field left out")
        shift = principal_point(camera, found["size"])
        turned = np.diag([-1.0, 1.0, -1.0, 1.0])  # Mitsuba's cameras look along +z, and +x is left
        sensor: Dict = {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f(_rigid(np.array(camera["matrix"])) @ turned),
            "fov": camera["fov"],
            "fov_axis": camera["fov_axis"],
            "near_clip": camera["clip"][0],
            "far_clip": camera["clip"][1],
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "multijitter"},
        }
        if any(shift):
            sensor["principal_point_offset_x"], sensor["principal_point_offset_y"] = shift
        sensors[camera["name"]] = sensor
    return sensors


def principal_point(camera: Mapping[str, Any], size: tuple[int, int]) -> tuple[float, float]:
    """Mitsuba's offset of the principal point. Blender's shift is in units of the extent across
    which its angle is measured."""
    extents = {"x": size[0], "y": size[1], "larger": max(size)}
    extent = extents[camera["fov_axis"]]
    x, y = camera["shift"]
    return x * extent / size[0], -y * extent / size[1] + 0.0


def _rigid(matrix: np.ndarray) -> np.ndarray:
    """A matrix without its scale."""
    found = matrix.copy()
    found[:3, :3] /= np.linalg.norm(found[:3, :3], axis=0)
    return found
