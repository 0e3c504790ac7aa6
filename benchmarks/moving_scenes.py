"""Animations to measure: scenes of `scenes/` in which something moves.

They are written as a user's would be: a folder with a scene file for each frame, which
`gpf fit --frames` and `gpf render --frames` take.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

from gpf.core.errors import UserError
from gpf.core.files import write_text
from gpf.modelling.meshes import write_ply
from gpf.scene.folders import scene_folder
from gpf.scene.snapshot import load_builder, snapshot_scene

FRAME_RATE = 24  # 1/s

LAMP_RANGE, LAMP_HEIGHT = (-0.6, 0.6), (0.99, 0.6)
DOOR_RANGE = (8, 62)  # degrees
BALL_RANGE = (-0.3, 0.4)

FrameText = Callable[[Path, str, int, int], str]
"""Writes the files of a frame to a folder, and returns the text of its scene file, from that of
the still scene, the frame's number and the number of all."""


def waves(folder: Path, text: str, number: int, count: int) -> str:
    """The pool's water runs on."""
    mesh = _builder("water_caustic_2").water(number / FRAME_RATE)
    write_ply(folder / "meshes" / f"water_{number:04d}.ply", mesh)
    return _replaced(text, "meshes/water.ply", f"meshes/water_{number:04d}.ply")


def door(folder: Path, text: str, number: int, count: int) -> str:
    """The door between the two rooms opens."""
    builder, degrees = _builder("veach_ajar"), _between(DOOR_RANGE, number, count)
    for name, mesh in (("door", builder.door(degrees)), ("knob", builder.knob(degrees))):
        write_ply(folder / "meshes" / f"{name}_{number:04d}.ply", mesh)
        text = _replaced(text, f"meshes/{name}.ply", f"meshes/{name}_{number:04d}.ply")
    return text


def lamp(folder: Path, text: str, number: int, count: int) -> str:
    """The lamp of the Cornell Box moves from one wall to the other, and down."""
    x, y = (_between(ends, number, count) for ends in (LAMP_RANGE, LAMP_HEIGHT))
    return _replaced(text, '<translate x="0" y="0.99" z="0.01"/>', f'<translate x="{x}" y="{y}"/>')


def ball(folder: Path, text: str, number: int, count: int) -> str:
    """The ball of glass moves through the fog, and its caustic in the air with it."""
    x = _between(BALL_RANGE, number, count)
    return _replaced(text, '"center" x="0.1"', f'"center" x="{x}"')


@dataclass(frozen=True)
class Animation:
    """A scene that moves.

    Attributes
    ----------
    scene: of `scenes/`.
    count: number of frames.
    view: the view that shows what moves.
    """

    scene: str
    count: int
    view: str
    write_frame: FrameText

    def write(self, folder: Path, count: int | None = None) -> Path:
        """Write the files of all frames to a folder, or of the first ``count``."""
        snapshot_scene(self.scene, folder)
        still = folder / "scene.xml"
        text = still.read_text(encoding="utf-8")
        for number in range(count or self.count):
            frame = self.write_frame(folder, text, number, self.count)
            write_text(folder / f"frame_{number:04d}.xml", frame)
        still.unlink()
        return folder


ANIMATIONS = {
    "waves": Animation("water_caustic_2", 48, "main", waves),
    "door": Animation("veach_ajar", 24, "front", door),
    "lamp": Animation("cornell_box", 24, "front", lamp),
    "ball": Animation("glass_in_fog", 24, "front", ball),
}


def open_animation(name: str) -> Animation:
    """An animation by its name."""
    if name not in ANIMATIONS:
        raise UserError(name, "is not an animation", f"Give one of {', '.join(ANIMATIONS)}.")
    return ANIMATIONS[name]


def _builder(scene: str) -> ModuleType:
    return load_builder(scene_folder(scene) / "build.py")


def _between(ends: tuple[float, float], number: int, count: int) -> float:
    """From one end to the other, slowly at first and last."""
    return float(ends[0] + (ends[1] - ends[0]) * (1 - np.cos(np.pi * number / (count - 1))) / 2)


def _replaced(text: str, old: str, new: str) -> str:
    if old not in text:
        raise UserError("scene.xml", f"no longer has {old}", "Correct benchmarks/moving_scenes.py.")
    return text.replace(old, new)
