"""Texts of the good files: a scene with two lamps, and its cameras."""

from __future__ import annotations

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
    "camera_model": "OPENCV",
    "w": 10,
    "h": 8,
    "cx": 5.0,
    "cy": 4.0,
    "fl_x": 12.0,
    "fl_y": 12.0,
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
