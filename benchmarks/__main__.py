"""`python -m benchmarks`: speed of passes, field queries and training, compared with Mitsuba; and
whether a field is as bright as the truth.

Each line appears as soon as it is measured: what, its time, the time it is compared with, their
ratio, and the goal, an upper limit for the ratio or time.
"""

from __future__ import annotations

from benchmarks.energy import energy_row
from benchmarks.glass_sphere import PHOTONS, measure
from benchmarks.training import training_row
from gpf.core.machine import device_description
from gpf.core.runtime import choose_variant

SIZES, RADII = (256, 512), (0.02, 0.05)

# Rows, samples of the truth and passes of the fit.
ENERGY = 96, 512, 24


def main(variant: str = "auto") -> None:
    """Measure everything, one line after another."""
    choose_variant(variant)
    machine = device_description()
    print(f"{machine['cpu']}, {machine['cores']} cores, {machine['variant']}; the Cornell box with")
    print("a glass sphere. path: depth 2, one sample per pixel; ptracer: 100,000 paths.\n")
    show("what", "measured", "compared", "ratio", "goal")
    for size in SIZES:
        for radius in RADII:
            timings = measure(size, radius, methods=("path", "ptracer", "sppm"))
            pass_ = timings.milliseconds("sppm")
            show(
                f"SPPM pass, {size}², 100k paths, radius {radius}, vs ptracer + path "
                f"({1e-3 * PHOTONS / pass_:.2f} M paths/s, {1e-3 * size**2 / pass_:.2f} Mpixel/s)",
                f"{pass_:.1f} ms",
                f"{timings.milliseconds('ptracer') + timings.milliseconds('path'):.1f} ms",
                f"{timings.ratio('sppm', 'ptracer', 'path'):.2f}",
                "1.25" if radius > min(RADII) else "1.0",
            )
    for size in SIZES:
        timings = measure(size, radius=0.02, methods=("path", "gpf", "gpf, recorded"))
        for method in ("gpf", "gpf, recorded"):
            spent = timings.milliseconds(method)
            show(
                f"one sample per pixel ({method}), {size}², vs path ({1e3 / spent:.0f} frames/s)",
                f"{spent:.1f} ms",
                f"{timings.milliseconds('path'):.1f} ms",
                f"{timings.ratio(method, 'path'):.2f}",
                "1.3" if size == min(SIZES) else "1.5",
            )
    show(*training_row())
    show(*energy_row(*ENERGY))


def show(what: str, measured: str, compared: str, ratio: str, goal: str) -> None:
    """Print one line."""
    print(f"{what:92} {measured:>9} {compared:>14} {ratio:>6} {goal:>6}", flush=True)


if __name__ == "__main__":
    main()
