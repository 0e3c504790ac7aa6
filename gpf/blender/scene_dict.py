"""What Blender wrote about a scene, as a dictionary for Mitsuba, and its cameras."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.blender.lights import emitters, sky
from gpf.blender.materials import Material, translate
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


def translate_scene(found: Mapping[str, Any], work: Path, folder: Path) -> Translation:
    """Translate a description; images are written into ``folder``.

    Parameters
    ----------
    found: ``scene.json`` of ``program/read.py``.
    work: the folder with it.
    """
    textures = Textures(work, folder, found["images"])
    result = Translation({"type": "scene", "integrator": {"type": "path", "max_depth": 32}})
    result.notes += found["notes"]
    result.scene |= cameras(found, result.notes)
    materials = _Materials(found, textures, result)
    for number, shape in enumerate(found["shapes"]):
        result.scene[f"shape_{number:04}"] = _shape(shape, materials)
    for number, (key, shapes) in enumerate(found["groups"].items()):
        group: Dict = {"type": "shapegroup", "id": f"group_{number}"}
        for k, shape in enumerate(shapes):
            group[f"shape_{k}"] = _shape(shape, materials)
        result.scene[f"group_{number}"] = group
        for k, instance in enumerate(i for i in found["instances"] if i["group"] == key):
            result.scene[f"group_{number}_copy_{k}"] = {
                "type": "instance",
                "to_world": mi.ScalarTransform4f(np.array(instance["matrix"])),
                "group": {"type": "ref", "id": f"group_{number}"},
            }
    result.scene |= emitters(found["lamps"], result.notes)
    result.scene |= sky(found["world"], found["lamps"], work, folder)
    result.notes += [f"image missing: {name}" for name in sorted(textures.missing)]
    result.notes += [f"library missing: {name}" for name in found["missing_libraries"]]
    return result


class _Materials:
    """The BSDFs of a scene: one for each closure, which objects share."""

    def __init__(self, found: Mapping[str, Any], textures: Textures, result: Translation) -> None:
        self.textures, self.result = textures, result
        self._closures = {(c["object"], c["slot"]): c["closure"] for c in found["closures"]}
        self._made: dict[str, tuple[Material, str]] = {}
        self._names: dict[str, int] = defaultdict(int)

    def find(self, shape: Mapping[str, Any]) -> tuple[Material, str]:
        """The material of a shape, and the id of its BSDF in the scene."""
        plain = {"closure": "diffuse", "color": [0.8, 0.8, 0.8]}
        closure = self._closures.get((shape["name"], shape["slot"]), plain)
        key = f"{shape['material']} {closure}"
        if key not in self._made:
            name = shape["material"] or "no material"
            self._names[name] += 1
            number = self._names[name]
            label = "".join(c if c.isalnum() else "_" for c in name)
            label = f"material_{label}" + (f"_{number}" if number > 1 else "")
            made = translate(closure, self.textures)
            self.result.scene[label] = made.whole() | {"id": label}
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
    return made


def cameras(found: Mapping[str, Any], notes: list[str]) -> Dict:
    """Sensors, the scene's own first; other kinds than perspective ones are left out."""
    sensors = {}
    width, height = found["size"]
    for number, camera in enumerate(found["cameras"]):
        if camera["type"] != "PERSP":
            notes.append(f"camera {camera['name']}: {camera['type'].lower()} camera left out")
            continue
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
        sensors[f"camera_{number}"] = sensor
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
