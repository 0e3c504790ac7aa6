"""Inverse lighting: find the lamps and the paint with which a room looks like its photographs.

    python examples/inverse_lighting.py OUT --seconds 15

The room has a ball of glass, a bulb and a ceiling lamp. Unknown are the brightness and the colour
of both lamps, and the paint of the back wall. Light is linear in the lamps, and the picture has a
derivative with respect to the paint, so each round is one fit and one problem of least squares. The
derivative holds the light in the room fixed; the next fit finds how the new paint changed it. OUT
receives a picture of photograph, first guess and result.
"""

from pathlib import Path

import gpf  # before mitsuba: it finds libLLVM

# ruff: isort: split
import drjit as dr
import mitsuba as mi
import numpy as np
import typer

from gpf.core.progress import progress_bar, say
from gpf.scene.light_groups import LightGroups

gpf.choose_variant("auto")  # the GPU if there is one, else the CPU

TRUTH = {"bulb": [60.0, 36, 15], "ceiling": [1.0, 1.6, 2.4], "paint": [0.2, 0.45, 0.3]}
GUESS = {"bulb": [20.0, 20, 20], "ceiling": [2.0, 2, 2], "paint": [0.5, 0.5, 0.5]}
PAINT = "back.bsdf.reflectance.value"
ROUNDS, SPP, PHOTOGRAPH = 4, 64, 200


def make_scene(size: int, bulb: list, ceiling: list, paint: list) -> mi.Scene:
    """The room, with a camera of ``size`` rows; y is up."""
    T, color = mi.ScalarTransform4f, mi.ScalarColor3f

    def wall(turn: list, angle: float, reflectance: list) -> dict:
        place = T().rotate(turn, angle).translate([0, 0, -1])
        bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}}
        return {"type": "rectangle", "to_world": place, "bsdf": bsdf}

    def lamp(radiance: list) -> dict:
        return {"type": "area", "radiance": {"type": "rgb", "value": radiance}}

    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb"}
    view = T().look_at(origin=[0, 0, 3.8], target=[0, 0, 0], up=[0, 1, 0])
    square = T().translate([0, 0.99, 0]).rotate([1, 0, 0], 90).scale(0.3)
    glass = {"type": "dielectric", "specular_transmittance": color(1, 1, 1)}
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 40,
                "to_world": view,
                "film": film | {"rfilter": {"type": "box"}},
            },
            "back": wall([0, 1, 0], 0, paint),
            "left": wall([0, 1, 0], 90, [0.6, 0.2, 0.15]),
            "right": wall([0, 1, 0], -90, [0.6, 0.6, 0.55]),
            "floor": wall([1, 0, 0], -90, [0.55, 0.55, 0.55]),
            "top": wall([1, 0, 0], 90, [0.7, 0.7, 0.7]),
            "ball": {"type": "sphere", "center": [0.3, -0.6, 0.2], "radius": 0.4, "bsdf": glass},
            "bulb": {"type": "sphere", "center": [-0.6, 0.1, 0.3], "radius": 0.08}
            | {"emitter": lamp(bulb)},
            "ceiling": {"type": "rectangle", "to_world": square, "emitter": lamp(ceiling)},
        },
        optimize=False,
    )


def improve(
    scene: mi.Scene, integrator: mi.Integrator, known: dict, photograph: np.ndarray
) -> dict[str, list[float]]:
    """Lamps and paint with which the picture is closer to the photograph, by least squares.

    The picture is a sum of one for each lamp, and changes with the paint by its derivative.
    """
    names = integrator.field.lights.groups.names
    parts = []
    for name in names:
        integrator.lights = ", ".join(f"{other}={int(other == name)}" for other in names)
        parts.append(np.array(mi.render(scene, integrator=integrator, spp=SPP)))
    integrator.lights = ""
    params = mi.traverse(scene)
    paint = mi.Color3f(params[PAINT])
    dr.enable_grad(paint)
    dr.set_grad(paint, 1)
    params[PAINT] = paint
    params.update()
    image = mi.render(scene, params, integrator=integrator, spp=SPP)
    parts.append(np.array(dr.forward_to(image)))
    # Errors relative to the brightness.
    weight = 1 / (photograph + 0.1 * photograph.mean())
    better = {}
    for channel in range(3):
        terms = np.stack([(weight * part)[..., channel].ravel() for part in parts], axis=1)
        wanted = (weight * photograph)[..., channel].ravel()
        *levels, more = np.linalg.lstsq(terms, wanted, rcond=None)[0]
        for name, level in zip(names, levels, strict=True):
            better.setdefault(name, []).append(known[name][channel] * max(level, 0.1))
        painted = known["paint"][channel] + more
        better.setdefault("paint", []).append(min(max(painted, 0.02), 0.98))
    return {key: np.array(value).tolist() for key, value in better.items()}


def main(folder: Path, seconds: float = 15, size: int = 128) -> None:
    """Write inverse_lighting.png into FOLDER: photograph, first guess, result."""
    folder.mkdir(parents=True, exist_ok=True)
    sppm = mi.load_dict({"type": "sppm"})
    with progress_bar("photograph", 1):
        photograph = np.array(mi.render(make_scene(size, **TRUTH), integrator=sppm, spp=PHOTOGRAPH))
    known, shown = {key: list(value) for key, value in GUESS.items()}, [photograph]
    for number in range(ROUNDS):
        scene = make_scene(size, **known)
        with progress_bar(f"round {number + 1}: fitting", 1):
            field = gpf.fit(scene, seconds=seconds, groups=LightGroups.each(scene))
        integrator = mi.load_dict({"type": "gpf"})
        integrator.field = field
        if number == 0:
            shown.append(np.array(mi.render(scene, integrator=integrator, spp=SPP)))
        known = improve(scene, integrator, known, photograph)
        words = (f"{key} {np.round(value, 3).tolist()}" for key, value in known.items())
        say(f"round {number + 1}: " + ", ".join(words))
    shown.append(np.array(mi.render(make_scene(size, **known), integrator=sppm, spp=PHOTOGRAPH)))
    mi.util.write_bitmap(
        str(folder / "inverse_lighting.png"), np.concatenate(shown, axis=1), write_async=False
    )


if __name__ == "__main__":
    typer.run(main)
