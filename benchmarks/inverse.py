"""Inverse lighting by a field and by Mitsuba's ``prb``: ``examples/inverse_lighting.py``."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import count
from typing import Annotated

import drjit as dr
import mitsuba as mi
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from benchmarks import cli
from examples import inverse_lighting as room

KEYS = {
    "bulb": "bulb.emitter.radiance.value",
    "ceiling": "ceiling.emitter.radiance.value",
    "paint": room.PAINT,
}


def inverse(
    seconds: cli.Seconds = 10,
    rows: cli.Rows = 128,
    spp: Annotated[int, typer.Option(min=1, help="Samples of a step of prb.")] = 16,
    rate: Annotated[float, typer.Option(help="Learning rate of prb.")] = 0.03,
) -> None:
    """Lamps and paint found from one photograph: largest relative error of each, after each round
    of a fit, and of Mitsuba's `prb` with Adam after the same time.

    Both begin with the same guess, and errors count relative to the brightness: of blocks of pixels
    for the field, of pixels for `prb`, which optimises the logarithms of all values.
    """
    photograph = room.take_photograph(rows, room.TRUTH)
    table = Table("by", "s", *room.TRUTH)
    start, times = time.perf_counter(), []
    for number, (known, _) in enumerate(room.search(photograph, seconds), start=1):
        times.append(time.perf_counter() - start)
        table.add_row(f"field, {number} rounds", f"{times[-1]:.0f}", *errors(known))
    start, steps = time.perf_counter(), enumerate(descend(photograph, spp, rate), start=1)
    for wanted in times:
        for step, known in steps:
            if (spent := time.perf_counter() - start) >= wanted:
                table.add_row(f"prb, {step} steps", f"{spent:.0f}", *errors(known))
                break
    Console().print(table)


def errors(known: dict[str, list[float]]) -> list[str]:
    """The largest relative error of a channel, for lamps and paint."""
    far = (np.abs(np.divide(known[key], true) - 1).max() for key, true in room.TRUTH.items())
    return [f"{100 * error:.1f} %" for error in far]


def descend(photograph: np.ndarray, spp: int, rate: float) -> Iterator[dict[str, list[float]]]:
    """Lamps and paint after each step of gradient descent by ``prb``."""
    scene = room.make_scene(len(photograph), **room.GUESS)
    params, adam = mi.traverse(scene), mi.ad.Adam(lr=rate)
    for name, key in KEYS.items():
        adam[name] = dr.log(mi.Color3f(params[key]))
    prb = mi.load_dict({"type": "prb", "max_depth": 16})
    wanted = mi.TensorXf(photograph)
    weight = 1 / (wanted + 0.1 * float(photograph.mean()))
    for step in count(1):
        for name, key in KEYS.items():
            params[key] = dr.exp(adam[name])
        params.update()
        image = mi.render(scene, params, integrator=prb, spp=spp, seed=2 * step)
        dr.backward(dr.mean(dr.square(weight * (image - wanted)), axis=None))
        adam.step()
        yield {name: np.exp(np.array(adam[name])).ravel().tolist() for name in KEYS}
