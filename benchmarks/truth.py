"""`python -m benchmarks.truth SCENE [VIEW …]`: field and SPPM against a path tracer.

Needs the results of `dvc repro`, and a scene whose light a path tracer can find. The noise of the
references counts as an error of other methods. The path-traced image is independent of the field
and of SPPM, and less noisy.
"""

from __future__ import annotations

import sys
from typing import Any

import mitsuba as mi
import numpy as np
from rich.console import Console
from rich.table import Table

from gpf.core.images import read_exr
from gpf.core.progress import progress_bar
from metrics.image import flip_exposures
from stages.common.workspace import Workspace
from stages.metrics import Judge

SAMPLES, AT_ONCE = 8192, 256
SHOWN = ("psnr", "ssim", "lpips", "flip")


def main() -> None:
    """Print one table per view."""
    name, *views = sys.argv[1:]
    work = Workspace.open(name)
    judge = Judge.open(work)
    for view in views or list(judge.references):
        truth = trace(work, view)
        path_judge = Judge(work, {view: truth}, flip_exposures([truth]))
        layers, _ = read_exr(work.second_reference(view))
        passes = max(int(layer.removeprefix("sppm_")) for layer in layers)
        images = {
            "the reference": judge.references[view],
            f"a second SPPM, {passes} passes": layers[f"sppm_{passes}"],
            "GPF": read_exr(work.render("gpf", view))[0]["radiance"],
        }
        table = Table("", *SHOWN, title=f"{name}, {view}: against `path`, {SAMPLES} spp")
        for title, image in images.items():
            found = path_judge.compare(view, image)
            table.add_row(title, *(f"{found[key]:.3f}" for key in SHOWN))
        Console(width=120).print(table)


def trace(work: Workspace, view: str) -> np.ndarray:
    """The path-traced radiance of a view, W/(m² sr), (H, W, 3)."""
    scene, sensor = work.load_scene(), work.sensor(work.views.find(view))
    integrator = mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": 8})
    rounds = SAMPLES // AT_ONCE
    total: Any = 0.0
    with progress_bar(f"{work.scene}: {view} by path", rounds) as bar:
        for k in range(rounds):
            image = mi.render(scene, sensor=sensor, integrator=integrator, spp=AT_ONCE, seed=k)
            total = total + np.array(image, dtype=np.float64)
            bar(k + 1)
    return np.asarray(total / rounds, dtype=np.float32)


if __name__ == "__main__":
    main()
