"""`python -m benchmarks`: speed of passes, field queries and training, beside Mitsuba's own."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from benchmarks.glass_sphere import PHOTONS, measure
from benchmarks.training import training_rows
from gpf.core.runtime import choose_variant, device_description


def main() -> None:
    """Measure everything and print one table; `goal` is the largest ratio or time aimed at."""
    choose_variant("auto")
    console = Console(width=140)
    machine = device_description()
    console.print(f"{machine['cpu']}, {machine['cores']} cores, {machine['variant']}")
    table = Table("what", "measured", "compared with", "ratio", "goal")
    for size in (256, 512):
        for radius in (0.02, 0.05):
            timings = measure(size, radius, methods=("path", "ptracer", "sppm"))
            pass_ = timings.milliseconds("sppm")
            floor = timings.milliseconds("ptracer") + timings.milliseconds("path")
            table.add_row(
                f"SPPM pass, {size}², 100k paths, r {radius}, and ptracer + path: "
                f"{1e-3 * PHOTONS / pass_:.2f} M paths/s, {1e-3 * size**2 / pass_:.2f} Mpixel/s",
                f"{pass_:.1f} ms",
                f"{floor:.1f} ms",
                f"{timings.ratio('sppm', 'ptracer', 'path'):.2f}",
                "1.25",
            )
    for size in (256, 512):
        timings = measure(size, radius=0.02, methods=("path", "gpf", "gpf, recorded"))
        for method in ("gpf", "gpf, recorded"):
            spent = timings.milliseconds(method)
            table.add_row(
                f"one sample per pixel from the field ({method}), {size}², and path: "
                f"{1e3 / spent:.0f} frames/s",
                f"{spent:.1f} ms",
                f"{timings.milliseconds('path'):.1f} ms",
                f"{timings.ratio(method, 'path'):.2f}",
                "1.6",
            )
    for row in training_rows():
        table.add_row(*row)
    console.print(table)


if __name__ == "__main__":
    main()
