"""A camera flies around glass and coloured balls: one field, many frames.

    python examples/animation.py OUT --seconds 30 --frames 48

All frames take their light from the same field, so caustics and shadows stand still and only the
camera moves. OUT receives the film, or its frames if no video encoder is installed.
"""

from pathlib import Path

import gpf  # before mitsuba: it finds libLLVM

# ruff: isort: split
import mitsuba as mi
import numpy as np
import typer

from gpf.core.films import write_film
from gpf.core.progress import progress_bar, say

gpf.choose_variant("auto")  # the GPU if there is one, else the CPU


def diffuse(*color: float) -> dict:
    """A matt material."""
    return {"type": "diffuse", "reflectance": mi.ScalarColor3f(*color)}


def make_scene() -> mi.Scene:
    """A glass ball among six coloured balls on a round table; z is up."""
    ball, disk = {"type": "sphere", "radius": 0.28}, mi.ScalarTransform4f().scale(2.6)
    scene = {
        "type": "scene",
        "table": {"type": "disk", "to_world": disk, "bsdf": diffuse(0.7, 0.7, 0.7)},
        "glass": ball | {"center": [0, 0, 0.6], "radius": 0.6, "bsdf": {"type": "dielectric"}},
        "lamp": ball | {"center": [2, 1, 4.5], "emitter": {"type": "area", "radiance": 120.0}},
        "sky": {"type": "constant", "radiance": mi.ScalarColor3f(0.15, 0.2, 0.3)},
    }
    for k, angle in enumerate(np.arange(6) * np.pi / 3):
        place = [1.5 * np.cos(angle), 1.5 * np.sin(angle), 0.28]
        hue = 0.45 + 0.4 * np.cos(angle + np.array([0, -2, 2]) * np.pi / 3)
        scene[f"ball_{k}"] = ball | {"center": place, "bsdf": diffuse(*hue)}
    return mi.load_dict(scene, optimize=False)


def make_camera(angle: float, size: int) -> mi.Sensor:
    """A camera on its way around the table, which it looks at; it rises and sinks."""
    origin = (5 * np.sin(angle), -5 * np.cos(angle), 3 - np.cos(2 * angle))
    view = gpf.View(name="orbit", origin=origin, target=(0, 0, 0.2), up=(0, 0, 1), fov=40)
    return gpf.make_sensor(view, size, size, spp=36, sampler="multijitter")


def main(folder: Path, seconds: float = 30, size: int = 256, frames: int = 48) -> None:
    """Write animation.mp4, or the frames, into FOLDER, and four of them into animation.png."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = make_scene()
    say(f"Fitting for {seconds:g} seconds.")
    integrator = mi.load_dict({"type": "gpf", "record": True})  # one kernel for all frames
    around = [make_camera(angle, size) for angle in np.arange(4) * np.pi / 2]
    integrator.field = gpf.fit(scene, around, seconds=seconds)
    pictures = []
    with progress_bar("rendering", frames) as bar:
        for k in range(frames):
            camera = make_camera(2 * np.pi * k / frames, size)
            image = mi.render(scene, sensor=camera, integrator=integrator, seed=k)
            pictures.append(np.array(mi.util.convert_to_bitmap(image)))
            bar(k + 1)
    try:
        write_film(folder / "animation.mp4", pictures, fps=24)
    except gpf.UserError as error:
        say(str(error))
        for k, picture in enumerate(pictures):
            mi.Bitmap(picture).write(str(folder / f"frame_{k:03d}.png"))
    a, b, c, d = (pictures[k * frames // 4] for k in range(4))
    mi.Bitmap(np.vstack([np.hstack([a, b]), np.hstack([c, d])])).write(
        str(folder / "animation.png")
    )


if __name__ == "__main__":
    typer.run(main)
