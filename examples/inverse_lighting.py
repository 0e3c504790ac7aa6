"""Inverse lighting: find the lamps and the paint with which a room looks like its photographs.

    python examples/inverse_lighting.py OUT --seconds 10

The room has a ball of glass, a bulb in a globe of glass, and a ceiling lamp. Unknown are the
brightness and the colour of both lamps, and the paint of the back wall. Light is linear in the
lamps, and the picture has a derivative with respect to the paint, so each round is one fit and one
problem of least squares. The derivative holds the light in the room fixed; the next fit finds how
the new paint changed it.
"""

from collections.abc import Iterator
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

BULB = [-0.5, 0.1, 0.3]
TRUTH = {"bulb": [150.0, 90, 40], "ceiling": [1.0, 1.6, 2.4], "paint": [0.2, 0.45, 0.3]}
GUESS = {"bulb": [50.0, 50, 50], "ceiling": [2.0, 2, 2], "paint": [0.5, 0.5, 0.5]}
PAINT = "back.bsdf.reflectance.value"
ROUNDS, SPP, PASSES, BLOCK = 3, 256, 200, 8


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
            "bulb": {"type": "sphere", "center": BULB, "radius": 0.05, "emitter": lamp(bulb)},
            "globe": {"type": "sphere", "center": BULB, "radius": 0.2, "bsdf": glass},
            "hollow": {"type": "sphere", "center": BULB, "radius": 0.18, "bsdf": glass}
            | {"flip_normals": True},
            "ceiling": {"type": "rectangle", "to_world": square, "emitter": lamp(ceiling)},
        },
        optimize=False,
    )


def improve(
    scene: mi.Scene, integrator: mi.Integrator, known: dict, photograph: np.ndarray
) -> dict[str, list[float]]:
    """Lamps and paint with which the picture is closer to the photograph, by least squares.

    The picture is a sum of one for each lamp, and changes with the paint by its derivative. Means
    over blocks of pixels are compared: they keep the light of a caustic that a short fit blurs.
    """
    names = integrator.field.lights.groups.names
    parts = []
    for name in names:
        integrator.lights = ", ".join(f"{other}={int(other == name)}" for other in names)
        parts.append(blocks(mi.render(scene, integrator=integrator, spp=SPP)))
    integrator.lights = ""
    params = mi.traverse(scene)
    paint = mi.Color3f(params[PAINT])
    dr.enable_grad(paint)
    dr.set_grad(paint, 1)
    params[PAINT] = paint
    params.update()
    image = mi.render(scene, params, integrator=integrator, spp=SPP)
    parts.append(blocks(dr.forward_to(image)))
    wanted = blocks(photograph)
    weight = 1 / (wanted + 0.1 * wanted.mean())  # errors count relative to the brightness
    better = {}
    for channel in range(3):
        terms = np.stack([(weight * part)[:, channel] for part in parts], axis=1)
        target = (weight * wanted)[:, channel]
        *levels, more = np.linalg.lstsq(terms, target, rcond=None)[0]
        for name, level in zip(names, levels, strict=True):
            better.setdefault(name, []).append(known[name][channel] * max(level, 0.1))
        painted = known["paint"][channel] + more
        better.setdefault("paint", []).append(min(max(painted, 0.02), 0.98))
    return {key: np.array(value).tolist() for key, value in better.items()}


def blocks(image: mi.TensorXf | np.ndarray) -> np.ndarray:
    """Means over blocks of pixels, (N, 3)."""
    side = len(image) // BLOCK
    kept = np.array(image)[: side * BLOCK, : side * BLOCK]
    return kept.reshape(side, BLOCK, side, BLOCK, 3).mean(axis=(1, 3)).reshape(-1, 3)


def search(photograph: np.ndarray, seconds: float) -> Iterator[tuple[dict, mi.TensorXf]]:
    """Lamps and paint after each round, and a picture of what was known before it."""
    known = {key: list(value) for key, value in GUESS.items()}
    for number in range(1, ROUNDS + 1):
        scene = make_scene(len(photograph), **known)
        with progress_bar(f"round {number}: fitting", 1):
            field = gpf.fit(scene, seconds=seconds, groups=LightGroups.each(scene))
        integrator = mi.load_dict({"type": "gpf"})
        integrator.field = field
        before = mi.render(scene, integrator=integrator, spp=SPP)
        known = improve(scene, integrator, known, photograph)
        words = (f"{key} {np.round(value, 3).tolist()}" for key, value in known.items())
        say(f"round {number}: " + ", ".join(words))
        yield known, before


def take_photograph(size: int, lamps_and_paint: dict, passes: int = PASSES) -> np.ndarray:
    """A picture of the room by passes of photon mapping, (size, size, 3)."""
    with progress_bar("photograph", 1):
        sppm, scene = mi.load_dict({"type": "sppm"}), make_scene(size, **lamps_and_paint)
        return np.array(mi.render(scene, integrator=sppm, spp=passes))


def main(folder: Path, seconds: float = 10, size: int = 128, passes: int = PASSES) -> None:
    """Write inverse_lighting.png into FOLDER.

    Above photograph and first guess, below result and its difference from the photograph, times 5.
    """
    folder.mkdir(parents=True, exist_ok=True)
    photograph = take_photograph(size, TRUTH, passes)
    found = list(search(photograph, seconds))
    guessed, result = np.array(found[0][1]), take_photograph(size, found[-1][0], passes)
    difference = 5 * np.abs(result - photograph)
    sheet = np.vstack([np.hstack([photograph, guessed]), np.hstack([result, difference])])
    mi.util.write_bitmap(str(folder / "inverse_lighting.png"), sheet, write_async=False)


if __name__ == "__main__":
    typer.run(main)
