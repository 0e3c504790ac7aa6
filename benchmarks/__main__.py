"""`python -m benchmarks`: print the speed figures."""

from __future__ import annotations

import gpf  # noqa: F401  (first: it tells Dr.Jit where libLLVM is)
from gpf.runtime import choose_variant, device_description

choose_variant("auto")

from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from benchmarks.glass_sphere import measure  # noqa: E402
from benchmarks.training import training_rows  # noqa: E402


def main() -> None:
    """Run all benchmarks and print one table."""
    console = Console()
    machine = device_description()
    console.print(f"{machine['cpu']}, {machine['cores']} cores, {machine['variant']}")
    table = Table("what", "measured", "floor", "ratio", "reach")
    timings = measure(size=256, radius=0.02)
    floor = timings.milliseconds("ptracer") + timings.milliseconds("path")
    table.add_row(
        "SPPM pass, 256², 100k paths, r 0.02, over ptracer + path",
        f"{timings.milliseconds('sppm'):.1f} ms",
        f"{floor:.1f} ms",
        f"{timings.ratio('sppm', 'ptracer', 'path'):.2f}",
        "1.5",
    )
    for method in ("gpf", "gpf, recorded"):
        table.add_row(
            f"one sample per pixel from the field ({method}), over path",
            f"{timings.milliseconds(method):.1f} ms",
            f"{timings.milliseconds('path'):.1f} ms",
            f"{timings.ratio(method, 'path'):.2f}",
            "2.0",
        )
    for row in training_rows():
        table.add_row(*row)
    console.print(table)


if __name__ == "__main__":
    main()
