"""Two rooms with a door between them: a lamp in one, a camera in the other."""

import mitsuba as mi

from gpf.scene.views import View

T = mi.ScalarTransform4f
RIGHT_ROOM = View(name="right", origin=(1.8, 0, -0.5), target=(0.5, 0, -0.5), fov=60)


def two_rooms(gap: float, height: float = 0.5) -> mi.Scene:
    """Rooms x in [-2, 0] and [0, 2] (y, z in [-1, 1]); in the left one a lamp at z = ``height``.

    The wall between them leaves a slit of width ``gap`` along z = 1.
    """
    half = 1 - gap / 2
    wall = T().translate([0, 0, -gap / 2]).rotate([0, 1, 0], 90).scale([half, 1, 1])
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.6}}
    return mi.load_dict(
        {
            "type": "scene",
            "shell": {
                "type": "cube",
                "to_world": T().scale([2, 1, 1]),
                "flip_normals": True,
                "bsdf": grey,
            },
            "wall": {
                "type": "rectangle",
                "to_world": wall,
                "bsdf": {"type": "twosided", "bsdf": grey},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": T().translate([-1.9, 0, height]).rotate([0, 1, 0], 90).scale(0.2),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0}},
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [9, 8, 7]}},
            },
        },
        optimize=False,
    )
