"""Make the README's pictures and table: `python docs/pictures.py`, after `dvc repro`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from shutil import copyfile

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from gpf.artifacts import read_json, write_text
from gpf.config import read_params
from gpf.images import read_exr, tone_map
from metrics.image import psnr
from stages.workspace import Workspace

IMAGES = Path("docs/images")
BEGIN, END = "<!-- results -->", "<!-- /results -->"


def draw_scene(scene: str, views: int = 2) -> None:
    """Some novel views of a scene: SPPM with 3 passes, the field, the reference, the error."""
    work = Workspace.open(scene)
    exposure = work.views.exposure
    names = [view.name for view in work.views.novel][:views]
    size = 8.8, (2.15 / work.views.aspect + 0.2) * views
    figure, rows = plt.subplots(views, 4, figsize=size, layout="constrained", squeeze=False)
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


def results_table(scenes: Sequence[str]) -> str:
    """The README's table, in Markdown, from the metric and cost files."""
    lines = [
        "| scene | method | PSNR | SSIM | LPIPS | FLIP | seconds per view |",
        "|---|---|---|---|---|---|---|",
    ]
    notes = []
    for scene in scenes:
        work = Workspace.open(scene)
        cost = read_json(work.folder / "amortize.json", "amortize")
        reference = read_json(work.cost("reference"), "reference")["facts"]
        passes, spp = work.params.reference.passes, work.params.render.spp
        per_pass = reference["seconds_per_single_view_pass"]
        methods = {
            "sppm_3": ("SPPM, 3 passes", 3 * per_pass),
            "gpf": (f"**GPF, {spp} spp**", cost["seconds_per_view"]["GPF"]),
            "ceiling": (f"ceiling: SPPM, {passes} passes", passes * per_pass),
        }
        for method, (title, seconds) in methods.items():
            m = read_json(work.metrics(method), "metrics")["mean"]
            numbers = (f"{m['psnr']:.1f}", *(_number(m[k]) for k in ("ssim", "lpips", "flip")))
            time = f"{seconds:.0f}" if seconds >= 10 else f"{seconds:.2f}"
            lines.append(f"| {scene} | {title} | {' | '.join(numbers)} | {time} |")
        worth = read_json(work.metrics("gpf"), "metrics")["worth_sppm_passes"]
        breaks = cost["break_even_views"]
        notes.append(
            f"{scene}: worth {', '.join(worth.values())} passes in its {len(worth)} novel views; "
            f"{cost['preparation_seconds']:.0f} s of preparation; cheaper than SPPM with {passes} "
            f"passes from view {breaks['SPPM']} on, than SPPM of the same PSNR from view "
            f"{breaks['SPPM at equal quality']} on."
        )
    return "\n".join([*lines, "", *(f"- {note}" for note in notes)])


def _number(value: float | None) -> str:
    return "missing" if value is None else f"{value:.3f}"


def write_table(readme: Path, table: str) -> None:
    """Put the table between the marks in the README."""
    before, _, rest = readme.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    write_text(readme, f"{before}{BEGIN}\n{table}\n{END}{after}")


if __name__ == "__main__":
    all_scenes = read_params().scenes
    for name in all_scenes:
        draw_scene(name)
        copyfile(f"results/{name}/cost.png", IMAGES / f"cost_{name}.png")
    write_table(Path("README.md"), results_table(all_scenes))
