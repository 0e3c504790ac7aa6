"""`python -m benchmarks.lights [--passes N] [SCENE …]`: cost and accuracy of light groups.

A field is fitted without groups and with one for each emitter. Then the first emitter becomes
warmer, and the others are dimmed to a quarter. One line per scene: the time of the fit and of a
picture with groups, divided by those without; and two PSNRs, against SPPM with 1000 passes of the
scene with its emitters changed like this: of the field at these levels, and of a field fitted to
that scene.
"""

from __future__ import annotations

import argparse
import time

import mitsuba as mi
import numpy as np
from rich.console import Console
from rich.table import Table

import gpf
from benchmarks.judged import (
    FIT_ROWS,
    Kept,
    judged_views,
    mean_psnr,
    options,
    references,
    render,
    training_views,
)
from benchmarks.placement import open_scene
from benchmarks.timing import time_in_turn
from gpf.core.progress import progress_bar
from gpf.core.structs import from_numpy
from gpf.field.field import GaussianPhotonField
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.lights import LightMixer
from gpf.rendering.settings import RenderSettings
from gpf.scene.light_groups import LightGroups
from gpf.scene.sensors import make_sensor

# What Mitsuba calls the colours of emitters.
KINDS = ("radiance", "irradiance", "intensity")
COLOURS = [f"{kind}.{form}" for kind in KINDS for form in ("value", "data")]

DIMMED, WARMER = (0.25, 0.25, 0.25), (1.2, 0.8, 0.4)


def main() -> None:
    """Print one line for each scene."""
    parser = options(__doc__.splitlines()[0], passes=100)
    parser.add_argument("--passes", type=int, default=200)
    parser.set_defaults(scenes=["corridor", "veach_ajar", "veach_bidir", "water_caustic_2"])
    arguments = parser.parse_args()
    columns = ("groups", "fit", "picture", "dimmed field", "refitted field")
    table = Table("scene", *columns)
    for name in arguments.scenes:
        table.add_row(name, *judge(name, arguments))
        Console(width=100).print(table)


def judge(name: str, arguments: argparse.Namespace) -> list[str]:
    """The cells of a scene."""
    scene, own, aspect = open_scene(name)
    views, exposure = judged_views(name, scene, own, aspect)
    size = round(FIT_ROWS * aspect), FIT_ROWS
    sensors = [make_sensor(view, *size) for view in training_views(name, own)]
    groups = LightGroups.each(scene)
    levels = dict.fromkeys(groups.names, DIMMED) | {groups.names[0]: WARMER}

    def fit(of: mi.Scene, kept: LightGroups | None) -> tuple[GaussianPhotonField, float]:
        start = time.perf_counter()
        with progress_bar(f"{name}: fit", 1):
            field = gpf.fit(of, sensors, passes=arguments.passes, groups=kept)
        return field, time.perf_counter() - start

    fit(scene, groups)  # compiles the kernels
    plain, seconds = fit(scene, None)
    grouped, seconds_grouped = fit(scene, groups)

    changed, _, _ = open_scene(name)
    change_emitters(changed, list(levels.values()))
    fitted, _ = fit(changed, None)
    kept = Kept(arguments.kept, arguments.reference_passes)
    judged = references(f"{name}_dimmed", changed, views, size, exposure, kept)
    own_errors = judged.differences(render(changed, fitted, judged))

    settings = RenderSettings()
    pictures = {
        "plain": FieldRenderer.make(scene, plain, settings),
        "grouped": FieldRenderer.make(scene, grouped, settings),
    }
    timings = time_in_turn(
        {n: lambda k, r=r: r.render(views[0], size, k) for n, r in pictures.items()}, rounds=5
    )
    mixer = LightMixer(scene, grouped)
    mixer.set(levels)
    dimmed_errors = judged.differences(render(scene, grouped, judged))
    return [
        f"{len(groups.names)}",
        f"{seconds_grouped / seconds:.2f}",
        f"{timings.ratio('grouped', 'plain'):.2f}",
        mean_psnr(dimmed_errors),
        mean_psnr(own_errors),
    ]


def change_emitters(scene: mi.Scene, levels: list[tuple[float, float, float]]) -> None:
    """Multiply the colour of each emitter in the scene itself."""
    for emitter, level in zip(scene.emitters(), levels, strict=True):
        parameters = mi.traverse(emitter)
        (key,) = (key for key in (*COLOURS, "data") if key in parameters)
        colour = parameters[key]
        if isinstance(colour, mi.TensorXf):
            values = np.array(colour)
            values[..., :3] *= level
            parameters[key] = from_numpy(mi.TensorXf, values)
        else:
            parameters[key] = colour * mi.Color3f(level)
        parameters.update()


if __name__ == "__main__":
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    main()
