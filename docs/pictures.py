"""Make the README's pictures from results/: `python docs/pictures.py` after `dvc repro`."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from gpf.config import read_params
from gpf.images import read_exr, tone_map
from metrics.image import psnr
from stages.workspace import Workspace

IMAGES = Path("docs/images")


def draw_scene(scene: str, views: int = 2) -> None:
    """Some novel views of a scene: SPPM with 3 passes, the field, the reference, the error."""
    work = Workspace.open(scene)
    exposure = work.views.exposure
    names = [view.name for view in work.views.novel][:views]
    figure, rows = plt.subplots(
        views, 4, figsize=(8.8, 2.35 * views), layout="constrained", squeeze=False
    )
    for row, name in zip(rows, names, strict=True):
        reference = read_exr(work.reference(name), "reference")[0]["radiance"]
        few = read_exr(work.ceiling(name), "reference")[0]["sppm_3"]
        field = read_exr(work.render("gpf", name), "render")[0]["radiance"]
        error = 10 * np.abs(tone_map(field, exposure) - tone_map(reference, exposure))
        passes = work.params.reference.passes
        pictures = {
            f"SPPM, 3 passes: {psnr(few, reference, exposure):.1f} dB": tone_map(few, exposure),
            f"GPF, {work.params.render.spp} spp: {psnr(field, reference, exposure):.1f} dB": (
                tone_map(field, exposure)
            ),
            f"reference: SPPM, {passes} passes": tone_map(reference, exposure),
            "error of GPF, × 10": np.clip(error, 0, 1),
        }
        for axes, (title, picture) in zip(row, pictures.items(), strict=True):
            axes.imshow(picture, interpolation="nearest")
            axes.set_title(title, fontsize=8)
            axes.set_axis_off()
    IMAGES.mkdir(parents=True, exist_ok=True)
    figure.savefig(IMAGES / f"{scene}.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    for scene_name in read_params().scenes:
        draw_scene(scene_name)
