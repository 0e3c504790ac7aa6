"""`python -m benchmarks.truth SCENE VIEW …`: field and SPPM against a patient path tracer.

After `dvc repro`, in scenes whose light a path tracer finds. References have noise of their own,
which counts against whoever does not share it; here the judge is independent of both, and has less.
"""

from __future__ import annotations

import sys

import gpf  # noqa: F401  (first: it tells Dr.Jit where libLLVM is)
from gpf.core.runtime import choose_variant

choose_variant("auto")

import mitsuba as mi  # noqa: E402
import numpy as np  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from gpf.core.images import read_exr  # noqa: E402
from gpf.core.progress import progress_bar  # noqa: E402
from metrics.image import compare, flip_exposures  # noqa: E402
from stages.common.workspace import Workspace  # noqa: E402
from stages.metrics import Judge  # noqa: E402

SAMPLES, AT_ONCE = 8192, 256
SHOWN = ("psnr", "ssim", "lpips", "flip")


def main() -> None:
    """Print one table per view."""
    name, *views = sys.argv[1:]
    work = Workspace.open(name)
    judge = Judge.open(work)
    for view in views or list(judge.references):
        truth = trace(work, view)
        layers, _ = read_exr(work.second_reference(view))
        passes = max(int(layer.removeprefix("sppm_")) for layer in layers if "sppm_" in layer)
        images = {
            "the reference": judge.references[view],
            f"a second SPPM, {passes} passes": layers[f"sppm_{passes}"],
            "GPF": read_exr(work.render("gpf", view))[0]["radiance"],
        }
        table = Table("", *SHOWN, title=f"{name}, {view}: against `path`, {SAMPLES} spp")
        first, last = flip_exposures([truth])
        epsilon = work.params.metrics.relmse_epsilon
        for title, image in images.items():
            found = compare(image, truth, work.views.exposure, first, last, epsilon)
            table.add_row(title, *(f"{found[key]:.3f}" for key in SHOWN))
        Console(width=120).print(table)


def trace(work: Workspace, view: str) -> np.ndarray:
    """Radiance of a view, (H, W, 3)."""
    scene, sensor = work.load_scene(), work.sensor(work.views.find(view))
    integrator = mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": 8})
    total, rounds = 0.0, SAMPLES // AT_ONCE
    with progress_bar(f"{work.scene}: {view} by path", rounds) as bar:
        for k in range(rounds):
            image = mi.render(scene, sensor=sensor, integrator=integrator, spp=AT_ONCE, seed=k)
            total = total + np.array(image, dtype=np.float64)
            bar(k + 1)
    return np.asarray(total / rounds, dtype=np.float32)


if __name__ == "__main__":
    main()
