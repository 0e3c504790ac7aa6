"""Builds the two rooms of this scene, the door between them, the furniture, and their textures.

Coordinates are those of ``scene.xml``: y is up, the dividing wall is across x, and the light is in
the room at smaller x. The door's hinges are at its edge of larger z; it is open by 17 degrees. All
shapes are made from the dimensions below; textures are scaled to given mean reflectances. There are
no random numbers: the builder writes the same bytes every time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gpf.core.images import tone_map, undo_tone_map
from gpf.modelling.meshes import Mesh, box, join, lathe, quad, write_ply
from gpf.modelling.textures import fractal_noise, ramp, smooth_noise, write_png
from scenes.modelling.landscape import landscape
from scenes.modelling.teapot import teapot_body, teapot_lid

Stops = list[tuple[float, tuple[float, float, float]]]

ROOM_LOW, ROOM_HIGH = np.array([-9.6463, 0, -7.6]), np.array([7.43, 3.8, 0.6])
WALL = (-3.0674, -2.83)  # x of the two faces of the dividing wall
DOORWAY = (-6.3535, -4.6278, 2.926)  # the wall's opening: its two z, and its height

DOOR_HINGE = (-2.7681, -4.6742)  # (x, z) of the edge with the hinges, on the camera's side
DOOR_ANGLE = 16.99  # degrees
DOOR_SIZE = (1.561, 2.7811, 0.0524)  # width, height, thickness
DOOR_FOOT = -0.0121
FRAME_LOW, FRAME_HIGH = (-3.0219, -0.0168, -6.4454), (-2.8173, 2.9362, -4.488)
FRAME_BAR = (0.2044, 0.1757)  # width of the upright bars, height of the lintel

HINGE_AXIS = (-2.7982, -4.6701)
HINGE_FEET = (0.1009, 1.3193, 2.4348)
KNUCKLES = ((0, 0.0793), (0.0803, 0.1596), (0.162, 0.2413))  # heights above each hinge's foot
KNOB_PLACE = (1.3857, 1.2247)  # distance from the hinges along the door, height above its foot
# (radius, distance from the face of the door): a neck with a flat ball.
KNOB = [(0, -0.003), (0.029, -0.003), (0.029, 0.008), (0.033, 0.022), (0.042, 0.029)]
KNOB += [(0.052, 0.034), (0.0613, 0.0395), (0.0667, 0.0465), (0.0687, 0.056), (0.0675, 0.0625)]
KNOB += [(0.064, 0.0685), (0.058, 0.0742), (0.05, 0.0785), (0.0395, 0.0815), (0.027, 0.0835)]
KNOB += [(0.014, 0.0842), (0, 0.0845)]

TABLE_LOW, TABLE_HIGH = (-2.7582, 0.5906, -4.2371), (-0.7582, 0.6506, -1.0371)
LEG_SIZE, LEG_TOP = 0.12, 0.6196
LEGS = ((-2.6203, -4.1053), (-2.6203, -1.2676), (-1.0009, -4.1053), (-1.0009, -1.2676))

# Mean linear reflectances of the textures; door and table have two sides each.
DOOR_FRONT, DOOR_BACK = (0.401, 0.115, 0.046), (0.356, 0.095, 0.036)
TABLE, UNDERSIDE = (0.688, 0.476, 0.217), (0.739, 0.508, 0.239)
PICTURE = (0.215, 0.234, 0.219)
# The door's wood is unevenly dark: relative tones in rows from the top down, in columns from the
# hinges outwards. They matter because light from the door's back lights the wall beside the gap.
FRONT_TONES = [(0.91, 0.78, 1.06, 1.06), (0.96, 0.97, 1.08, 1.03), (0.98, 1.18, 1.07, 0.9)]
BACK_TONES = [(1.16, 0.69, 0.81, 0.91), (1.1, 0.83, 1.08, 1.09), (0.96, 0.96, 1.17, 1.25)]

CHERRY = [(0, (0.72, 0.4, 0.25)), (0.6, (0.64, 0.33, 0.2)), (0.93, (0.55, 0.26, 0.15))]
CHERRY += [(1, (0.42, 0.17, 0.09))]
MAPLE = [(0, (0.89, 0.76, 0.54)), (0.7, (0.86, 0.73, 0.51)), (1, (0.79, 0.64, 0.42))]


def shell() -> Mesh:
    """Walls, ceiling, the floor of the light's room and the dividing wall, facing inwards."""
    (x0, _, z0), (x1, top, z1) = ROOM_LOW, ROOM_HIGH
    size = ROOM_HIGH - ROOM_LOW
    x, y, z = np.diag(size)
    left, right = WALL
    near, far, lintel = DOORWAY
    deep = [right - left, 0, 0]
    sides = [
        quad([x0, 0, z0], x, y),
        quad([x1, 0, z1], -x, y),
        quad([x0, 0, z1], -z, y),
        quad([x1, 0, z0], z, y),
        quad([x0, top, z0], x, z),
        quad([x0, 0, z1], [right - x0, 0, 0], -z),
        # the reveals of the doorway: its two sides and its top
        quad([left, 0, near], deep, [0, lintel, 0]),
        quad([right, 0, far], [left - right, 0, 0], [0, lintel, 0]),
        quad([left, lintel, near], deep, [0, 0, far - near]),
    ]
    parts = ((z0, near, 0.0), (far, z1, 0.0), (near, far, lintel))  # around the doorway
    for low, high, foot in parts:
        width, up = [0, 0, high - low], [0, top - foot, 0]
        sides.append(quad([left, foot, low], width, up))
        sides.append(quad([right, foot, high], [0, 0, low - high], up))
    return join(sides)


def door_matrix(degrees: float = DOOR_ANGLE) -> np.ndarray:
    """From the door's coordinates (x along the door from the hinges, y up, z out of its front) to
    the room's."""
    angle = np.radians(degrees)
    along, out = (np.sin(angle), 0, -np.cos(angle)), (np.cos(angle), 0, np.sin(angle))
    corner = (DOOR_HINGE[0], DOOR_FOOT, DOOR_HINGE[1])
    matrix = np.eye(4)
    matrix[:3] = np.array([along, (0, 1, 0), out, corner]).T
    return matrix


def door(degrees: float = DOOR_ANGLE) -> Mesh:
    """The slab; the texture's left half is for front and edges, its right half for the back."""
    width, height, thick = DOOR_SIZE
    mesh = box([0, 0, -thick], [width, height, 0])
    x, y, z = mesh.points.T
    u = np.clip((x - z) / width, 0, 1)
    back = np.arange(len(x)) // 4 == 5  # the last side of a box faces -z
    # A bitmap has v = 0 at its top.
    uv = np.stack([np.where(back, 1 - x / width / 2, u / 2), 1 - y / height], axis=1)
    return replace(mesh, uv=uv).transformed(door_matrix(degrees))


def knob(degrees: float = DOOR_ANGLE) -> Mesh:
    """The ball handle on the door's front."""
    turned = np.eye(4)  # the lathe's axis y becomes the door's z
    turned[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    turned[:2, 3] = KNOB_PLACE
    return lathe(np.array(KNOB), segments=48).smooth().transformed(door_matrix(degrees) @ turned)


def hinges() -> Mesh:
    """Three hinges of three knuckles each."""
    pins = []
    for foot in HINGE_FEET:
        for low, high in KNUCKLES:
            pin = lathe(np.array([(0, low), (0.02, low), (0.02, high), (0, high)]), segments=32)
            matrix = np.eye(4)
            matrix[:3, 3] = HINGE_AXIS[0], foot, HINGE_AXIS[1]
            pins.append(pin.transformed(matrix))
    return join(pins)


def frame() -> Mesh:
    """Two upright bars and a lintel; they reach into the dividing wall."""
    (x0, y0, z0), (x1, y1, z1) = FRAME_LOW, FRAME_HIGH
    bar, lintel = FRAME_BAR
    return join(
        [
            box([x0, y0, z0], [x1, y1 - lintel, z0 + bar]),
            box([x0, y0, z1 - bar], [x1, y1 - lintel, z1]),
            box([x0, y1 - lintel, z0], [x1, y1, z1]),
        ]
    )


def table_top() -> Mesh:
    """The board; its grain runs along z and over the edges.

    The texture's left half is for the top and the edges, its right half for the underside.
    """
    mesh = box(TABLE_LOW, TABLE_HIGH)
    size = np.subtract(TABLE_HIGH, TABLE_LOW)
    x, y, z = (mesh.points - TABLE_LOW).T
    under = np.arange(len(x)) // 4 == 3  # the fourth side of a box faces -y
    u = (x + y) / (size[0] + size[1]) / 2 + np.where(under, 0.5, 0)
    return replace(mesh, uv=np.stack([u, (z + y) / (size[2] + size[1])], axis=1))


def legs() -> Mesh:
    """Four square legs."""
    return join([box([x, -0.0067, z], [x + LEG_SIZE, LEG_TOP, z + LEG_SIZE]) for x, z in LEGS])


def wood(
    shape: tuple[int, int], boards: int, rings: float, colours: Stops, seed: int
) -> np.ndarray:
    """Planks glued side by side, linear reflectances (H, W, 3); the grain runs upwards.

    Each plank is a cut through a trunk at a distance from its pith. The distance varies along the
    grain, which makes arches of growth rings.
    """
    height, width = shape
    v, u = (np.arange(height)[:, None] + 0.5) / height, (np.arange(width)[None] + 0.5) / width
    number = np.floor(u * boards)
    across = u * boards - number - 0.5
    golden = (number + 1 + seed) * 0.618 % 1
    slow = fractal_noise(shape, (3, 2 * boards), 3, seed + 10) - 0.5
    depth = 0.5 * (golden - 0.3) + 0.7 * (v - golden) * np.where(number % 2, 1, -1) + 0.5 * slow
    sway = 0.3 * (smooth_noise(shape, (2, boards), seed + 20) - 0.5)
    ring = rings * np.hypot(across + 0.6 * (golden - 0.5) + sway, depth) + 1.2 * slow
    ring += 0.35 * fractal_noise(shape, (6, 24 * boards), 2, seed + 30)
    year, late = ring % 1, 0.88  # a ring darkens through the year and ends with a dark line
    line = 0.75 * np.minimum(year / late, 1)
    line += 0.25 * np.sin(np.pi * np.maximum(year - late, 0) / (1 - late))
    fibre = fractal_noise(shape, (12, width // 3), 2, seed + 40)
    value = 0.62 * line + 0.5 * (fibre - 0.5) + 0.35 * (golden - 0.5) + 0.5 * slow + 0.15
    return undo_tone_map(np.maximum(ramp(value, colours), 0.05))


def with_mean(linear: np.ndarray, mean: tuple[float, float, float]) -> np.ndarray:
    """Reflectances (H, W, 3) scaled to this mean, as sRGB."""
    scaled = linear
    for _ in range(8):  # repeated, because values are clamped to 0.95
        scaled = np.minimum(scaled * (mean / scaled.mean(axis=(0, 1))), 0.95)
    return tone_map(scaled, exposure=1)


def spread(tones: Sequence[tuple[float, ...]], shape: tuple[int, int]) -> np.ndarray:
    """A coarse grid of tones, interpolated linearly over a whole texture, (H, W, 1)."""
    value = np.array(tones)
    for size in shape:  # each step interpolates along one axis and transposes
        place = (np.arange(size) + 0.5) / size * len(value) - 0.5
        value = np.array([np.interp(place, np.arange(len(value)), line) for line in value.T])
    return value[..., None]


def build(folder: Path) -> list[Path]:
    """Write everything below ``folder/meshes`` and ``folder/textures``; return the paths."""
    shapes = {
        "shell": shell(),
        "door": door(),
        "knob": knob(),
        "hinges": hinges(),
        "frame": frame(),
        "table": table_top(),
        "legs": legs(),
        "teapot_body": teapot_body(),
        "teapot_lid": teapot_lid(),
    }
    half = (1024, 576)
    front = wood(half, 3, 11, CHERRY, seed=3) * spread(FRONT_TONES, half)
    # As seen from behind, the hinges are on the right.
    back = wood(half, 3, 11, CHERRY, seed=5) * spread(BACK_TONES, half)[:, ::-1]
    sides = [with_mean(front, DOOR_FRONT), with_mean(back, DOOR_BACK)]
    board = wood((1024, 640), 3, 26, MAPLE, seed=8)
    boards = [with_mean(board, TABLE), with_mean(board[::-1], UNDERSIDE)]
    pictures = {
        "door": np.concatenate(sides, axis=1),
        "table": np.concatenate(boards, axis=1),
        "landscape": with_mean(landscape(1024, 478), PICTURE),
    }
    made = [write_ply(folder / "meshes" / f"{name}.ply", mesh) for name, mesh in shapes.items()]
    return made + [write_png(folder / "textures" / f"{k}.png", v) for k, v in pictures.items()]
