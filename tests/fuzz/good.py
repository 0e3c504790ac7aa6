"""Good files that cases begin with: a scene with two lamps, its cameras and its fields."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import mitsuba as mi
import numpy as np

from gpf.core.structs import to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.io import read_field, save_field, write_field
from gpf.field.lights import FieldLights
from gpf.field.settings import FieldSettings
from gpf.scene.bounds import scene_bounds
from gpf.scene.fingerprint import fingerprint
from gpf.scene.light_groups import LightGroups
from gpf.scene.load import load_scene_file
from tests.plain_field import flat_gaussians, to_device

SCENE = """\
<scene version="3.0.0">
  <sensor type="perspective" id="eye"><float name="fov" value="50"/>
    <transform name="to_world"><lookat origin="0.5, 1.5, 4" target="0, 0.3, 0" up="0, 1, 0"/>
    </transform>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/></film>
  </sensor>
  <emitter type="point" id="lamp"><point name="position" x="0" y="3" z="0"/></emitter>
  <emitter type="constant" id="sky"><rgb name="radiance" value="0.1, 0.2, 0.3"/></emitter>
  <bsdf type="diffuse" id="white"/>
  <shape type="rectangle" id="floor">
    <transform name="to_world"><rotate x="1" angle="-90"/><scale value="3"/></transform>
    <ref id="white"/>
  </shape>
  <shape type="sphere" id="ball"><float name="radius" value="0.4"/><ref id="white"/></shape>
</scene>
"""
VIEWS = """\
exposure: 1.5
aspect: 1.25
fov_axis: x
views:
  train:
    - {name: front, origin: [0, 1, 4], target: [0, 0, 0], fov: 40}
    - {name: left, origin: [-2, 1, 3], target: [0, 0, 0], up: [0, 1, 0], fov: 40}
  novel:
    - {name: right, origin: [2, 1, 3], target: [0, 0, 0], fov: 30, fov_axis: y}
path:
  frames: 2
  closed: true
  keyframes:
    - {origin: [0, 1, 4], target: [0, 0, 0], fov: 40}
    - {origin: [1, 1, 4], target: [0, 0, 0], fov: 40}
"""
TRANSFORMS = {
    **{"camera_model": "OPENCV", "w": 10, "h": 8, "cx": 5.0, "cy": 4.0, "fl_x": 12.0, "fl_y": 12.0},
    "frames": [
        {
            "name": "front",
            "file_path": "front.png",
            "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 4], [0, 0, 0, 1]],
        },
        {
            "file_path": "left.png",
            "transform_matrix": [[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 4], [0, 0, 0, 1]],
        },
    ],
}
FIRST = {"scenes/first/scene.xml": SCENE.encode(), "scenes/first/views.yaml": VIEWS.encode()}
"""A folder of scenes with one scene in it."""


@cache
def good_fields() -> dict[str, bytes]:
    """Each kind of field's file."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scene.xml").write_text(SCENE)
        field = make_field(load_scene_file(folder / "scene.xml"))
        save_field(field, folder / "plain")
        save_field(field, folder / "compact", "compact")
        stored = read_field(folder / "plain")
        table = np.zeros((2, 1, 3), np.uint8)
        table[1] = 1
        levels = (stored.tensors["means"][:, 0] > 0).astype(np.uint8)
        tensors = {**stored.tensors, "levels": levels, "detail": table}
        grid = {"width": 3.0, "corner": [-3.0, -0.5, -3.0]}
        write_field(replace(stored, tensors=tensors, grid=grid), folder / "levels")
        return {kind: (folder / kind).read_bytes() for kind in ("plain", "compact", "levels")}


def make_field(scene: mi.Scene, count: int = 200) -> GaussianPhotonField:
    """Gaussians on the floor, with the light of two groups."""
    rng = np.random.default_rng(0)
    points = np.zeros((count, 3), np.float32)
    points[:, [0, 2]] = rng.uniform(-3, 3, (count, 2))
    gaussians = to_device(flat_gaussians(points, np.ones((count, 3)), size=0.3))
    field = GaussianPhotonField(
        gaussians,
        FieldSettings(search_radius=0.8),
        scene_bounds(scene),
        {"fingerprint": fingerprint(scene), "exposure": 1.0},
    )
    light = to_numpy(gaussians.irradiance)
    groups = LightGroups(("lamp", "sky"), ((0,), (1,)))
    field.lights = FieldLights(groups, np.stack([0.25 * light, 0.75 * light]).astype(np.float32))
    field.set_error(np.full(count, 0.05, np.float32))
    return field
