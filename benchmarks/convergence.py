"""`python -m benchmarks.convergence [FOLDER]`: the error of SPPM after n passes.

The Cornell box with a glass sphere at 256², compared with a path-traced image that is rendered once
and saved in FOLDER. Pixels that see the lamp directly are left out.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.glass_sphere import PHOTONS, load_scene
from gpf.core.runtime import choose_variant
from gpf.sppm.passes import PassSettings
from gpf.sppm.reference import ReferenceRenderer

SIZE, RADIUS, EPSILON = 256, 0.03, 0.01
COUNTS = (1, 4, 16, 64, 256, 1000)
TRUTH_SPP, TRUTH_STEP = 16_384, 512


def path_traced(scene: Any, file: Path) -> np.ndarray:
    """The path-traced image, (H, W, 3), from the file; rendered if that does not exist."""
    if file.exists():
        return np.asarray(np.load(file))
    integrator = mi.load_dict({"type": "path", "max_depth": -1})
    total: Any = 0.0
    for k in range(TRUTH_SPP // TRUTH_STEP):
        image = mi.render(scene, integrator=integrator, spp=TRUTH_STEP, seed=1000 + k)
        total = total + np.array(image, dtype=np.float64)
    truth = total * TRUTH_STEP / TRUTH_SPP
    file.parent.mkdir(parents=True, exist_ok=True)
    np.save(file, truth.astype(np.float32))
    return np.asarray(truth)


def relative_error(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """relMSE: mean of (I - T)² / (T² + ε)."""
    error = (image - truth) ** 2 / (truth**2 + EPSILON)
    return float(error[mask].mean())


def main() -> None:
    """Print relMSE after each number of passes, its slope, and the mean relative to the truth's."""
    choose_variant("auto")
    console = Console(width=140)
    scene = load_scene(SIZE, SIZE)
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("results/benchmarks")
    truth = path_traced(scene, folder / f"glass_sphere_{SIZE}_{TRUTH_SPP}.npy")
    lamp = np.array(mi.render(scene, integrator=mi.load_dict({"type": "path", "max_depth": 1})))
    mask = lamp.max(axis=2) == 0
    table = Table("direct", "α", *(f"{n} passes" for n in COUNTS), "slope", "mean", "s/pass")
    for direct in ("photons", "emitters"):
        for alpha in (2 / 3, 0.7, 0.8):
            settings = PassSettings(
                photons_per_pass=PHOTONS,
                initial_radius=RADIUS,
                alpha=alpha,
                direct=direct,  # type: ignore[arg-type]
            )
            sensor = scene.sensors()[0]
            renderer = ReferenceRenderer(scene, {"view": sensor}, {}, settings, seed=1)
            errors, sums, start = [], renderer.empty_sums(), time.perf_counter()
            for count in COUNTS:
                renderer.run(count, sums)
                errors.append(relative_error(renderer.image("view", sums), truth, mask))
            seconds = (time.perf_counter() - start) / COUNTS[-1]
            slope = np.polyfit(np.log(COUNTS), np.log(errors), 1)[0]
            mean = renderer.image("view", sums)[mask].mean() / truth[mask].mean()
            row = [*(f"{e:.5f}" for e in errors), f"{slope:.2f}", f"{mean:.4f}", f"{seconds:.3f}"]
            table.add_row(direct, f"{alpha:.2f}", *row)
    console.print(table)


if __name__ == "__main__":
    main()
