"""A gold ring and three glass balls: fit a field to a scene of your own, and render it.

    python examples/own_scene.py OUT --seconds 30

Glass and gold focus the light of the lamp. A path tracer seldom finds such caustics; the field
learns them from photons. OUT receives the field and the picture.
"""

from pathlib import Path

import gpf  # before mitsuba: it finds libLLVM

# ruff: isort: split
import mitsuba as mi
import typer

from gpf.core.progress import progress_bar, say

gpf.choose_variant("auto")  # the GPU if there is one, else the CPU


def glass_ball(x: float, y: float, radius: float, red: float, green: float, blue: float) -> dict:
    """A ball of coloured glass on the table."""
    glass = {"type": "dielectric", "specular_transmittance": mi.ScalarColor3f(red, green, blue)}
    return {"type": "sphere", "center": [x, y, radius], "radius": radius, "bsdf": glass}


def make_scene(size: int) -> mi.Scene:
    """The scene, with a camera of ``size`` rows; z is up."""
    T, color = mi.ScalarTransform4f, mi.ScalarColor3f
    view = T().look_at(origin=[0.5, -4.6, 4.4], target=[0.15, 0.1, 0.1], up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": 3 * size // 2, "height": size, "rfilter": {"type": "box"}}
    wood = {"type": "diffuse", "reflectance": color(0.75, 0.68, 0.6)}
    gold = {"type": "twosided", "bsdf": {"type": "conductor", "material": "Au"}}
    hoop = {"type": "cylinder", "radius": 0.85, "p0": [-0.95, 0.1, 0], "p1": [-0.95, 0.1, 0.35]}
    bulb = {"type": "sphere", "radius": 0.25, "center": [3.4, 3.0, 4.2]}
    scene = {
        "type": "scene",
        "camera": {"type": "perspective", "fov": 36, "to_world": view, "film": film},
        "table": {"type": "rectangle", "to_world": T().scale(4), "bsdf": wood},
        "ring": hoop | {"bsdf": gold},
        "clear": glass_ball(0.55, 0.75, 0.60, 1, 1, 1),
        "blue": glass_ball(1.30, -0.25, 0.38, 0.3, 0.6, 1),
        "red": glass_ball(0.45, -0.60, 0.28, 1, 0.25, 0.2),
        "lamp": bulb | {"emitter": {"type": "area", "radiance": 300.0}},
        "sky": {"type": "constant", "radiance": color(0.12, 0.15, 0.2)},
    }
    return mi.load_dict(scene, optimize=False)  # with optimize, Mitsuba would merge shapes


def main(folder: Path, seconds: float = 30, size: int = 256) -> None:
    """Write field.safetensors, own_scene.png and own_scene.exr into FOLDER."""
    folder.mkdir(parents=True, exist_ok=True)
    scene, file = make_scene(size), folder / "field.safetensors"
    with progress_bar("fitting", 1) as bar:

        def show(progress) -> None:
            bar.describe(f"fitting, {progress.psnr:.1f} dB" if progress.psnr else "fitting")
            bar(progress.passes + progress.steps, progress.all_passes + progress.all_steps)

        field = gpf.fit(scene, seconds=seconds, callback=show)
    gpf.save_field(field, file)
    say(f"{field.record['passes']} passes, estimated PSNR {field.record['estimated_psnr']:.1f} dB")

    # Another program needs only the scene and the file.
    integrator = mi.load_dict({"type": "gpf", "field": str(file), "adaptive": True})
    image = mi.render(scene, integrator=integrator, spp=64)
    for name in ("own_scene.png", "own_scene.exr"):
        mi.util.write_bitmap(str(folder / name), image, write_async=False)


if __name__ == "__main__":
    typer.run(main)
