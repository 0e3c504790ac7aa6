"""`python -m benchmarks`: speed of passes, field queries and training, compared with Mitsuba; and
whether a field is as bright as the truth.

Each line appears as soon as it is measured: what, its time, the time it is compared with, their
ratio, and the goal, an upper limit for the ratio or time. Times that are compared are measured in
turn, so that other load affects all of them.
"""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import cli
from benchmarks.dark_places import dark_rows
from benchmarks.energy import energy_row
from benchmarks.glass_sphere import PHOTONS, measure
from benchmarks.timing import Row
from benchmarks.training import training_row
from gpf.core.machine import device_description

SIZES, RADII = (256, 512), (0.02, 0.05)

# Rows, samples of the truth and passes of the fit.
ENERGY = 96, 512, 24


def bench() -> None:
    """Measure everything, one line after another."""
    machine = device_description()
    print(f"{machine['cpu']}, {machine['cores']} cores, {machine['variant']}; the Cornell box with")
    print("a glass sphere. path: depth 2, one sample per pixel; ptracer: 100,000 paths.\n")
    print(Row("what", "measured", "compared", "ratio", "goal"))
    for row in rows():
        print(row, flush=True)


def rows() -> Iterator[Row]:
    """All lines."""
    for size in SIZES:
        for radius in RADII:
            yield pass_row(size, radius)
    yield fog_row(min(SIZES), min(RADII))
    for size in SIZES:
        yield from sample_rows(size)
    yield from dark_rows(min(SIZES))
    yield training_row()
    yield energy_row(*ENERGY)


def pass_row(size: int, radius: float) -> Row:
    """A pass of SPPM."""
    timings = measure(size, radius, methods=("path", "ptracer", "sppm"))
    spent = timings.milliseconds("sppm")
    return Row(
        f"SPPM pass, {size}², 100k paths, radius {radius}, vs ptracer + path "
        f"({1e-3 * PHOTONS / spent:.2f} M paths/s, {1e-3 * size**2 / spent:.2f} Mpixel/s)",
        f"{spent:.1f} ms",
        f"{timings.milliseconds('ptracer') + timings.milliseconds('path'):.1f} ms",
        f"{timings.ratio('sppm', 'ptracer', 'path'):.2f}",
        "1.25" if radius > min(RADII) else "1.0",
    )


def fog_row(size: int, radius: float) -> Row:
    """A pass of SPPM where the box is full of fog."""
    timings = measure(size, radius, methods=("volpath", "ptracer", "sppm in fog"))
    return Row(
        f"SPPM pass in fog, {size}², 100k paths, vs ptracer without fog + volpath of any depth",
        f"{timings.milliseconds('sppm in fog'):.1f} ms",
        f"{timings.milliseconds('ptracer') + timings.milliseconds('volpath'):.1f} ms",
        f"{timings.ratio('sppm in fog', 'ptracer', 'volpath'):.2f}",
        "1.5",
    )


def sample_rows(size: int) -> Iterator[Row]:
    """One sample per pixel of a field, without and with recorded kernels."""
    timings = measure(size, radius=0.02, methods=("path", "gpf", "gpf, recorded"))
    for method in ("gpf", "gpf, recorded"):
        spent = timings.milliseconds(method)
        yield Row(
            f"one sample per pixel ({method}), {size}², vs path ({1e3 / spent:.0f} frames/s)",
            f"{spent:.1f} ms",
            f"{timings.milliseconds('path'):.1f} ms",
            f"{timings.ratio(method, 'path'):.2f}",
            "1.3" if size == min(SIZES) else "1.5",
        )


if __name__ == "__main__":
    cli.run(cli.make_app(bench))
