"""Stage `metrics`: images -> numbers, by one protocol for every method."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from gpf.artifacts import write_json, write_text
from gpf.errors import UserError
from gpf.images import check_finite, read_exr
from metrics.image import compare, flip_exposures, psnr
from metrics.worth import snapshot_passes, worth_passes
from stages.progress import progress_bar
from stages.workspace import Workspace

NUMBERS = ("psnr", "ssim", "lpips", "flip", "flip_hdr", "relmse")


def compare_images(scene_name: str) -> None:
    """Compare the field and SPPM at several pass counts with the references."""
    work = Workspace.open(scene_name)
    exposure = work.views.exposure
    epsilon = work.params.metrics.relmse_epsilon
    names = [view.name for view in work.views.novel]
    references = {
        name: read_exr(work.reference(name), "reference")[0]["radiance"] for name in names
    }
    for name, image in references.items():
        check_finite(image, str(work.reference(name)))
    passes = snapshot_passes(work.params.reference.passes)
    # Method -> layer of the ceiling's EXR, or the field's own image.
    methods = {"gpf": "gpf", "sppm_3": "sppm_3", "ceiling": f"sppm_{passes[-1]}"}
    start, stop = flip_exposures(list(references.values()))

    results: dict[str, Any] = {method: {} for method in methods}
    curves: dict[str, dict[int, float]] = {}
    with progress_bar(f"{scene_name}: metrics", len(names)) as advance:
        for done, name in enumerate(names, start=1):
            layers, _ = read_exr(work.ceiling(name), "reference")
            layers["gpf"] = read_exr(work.render("gpf", name), "render")[0]["radiance"]
            _check_layers(work, name, layers, references[name], passes)
            for method, layer in methods.items():
                results[method][name] = compare(
                    layers[layer], references[name], exposure, start, stop, epsilon
                )
            curves[name] = {
                n: psnr(layers[f"sppm_{n}"], references[name], exposure) for n in passes
            }
            advance(done)

    rows, summaries = [], {}
    for method, views in results.items():
        summary = {key: _mean([views[name][key] for name in names]) for key in NUMBERS}
        reasons = {k: v for name in names for k, v in views[name]["reasons"].items()}
        report = {"mean": summary, "views": views, "reasons": reasons}
        if method == "gpf":
            report["worth_sppm_passes"] = {
                name: str(worth_passes(views[name]["psnr"], curves[name])) for name in names
            }
        write_json(work.metrics(method), report)
        summaries[method] = summary
        rows.append({"scene": scene_name, "method": method, **summary})
    write_json(work.metrics("summary"), summaries)
    mean_curve = {n: float(np.mean([curves[name][n] for name in names])) for n in passes}
    write_json(
        work.metrics("convergence"),
        [{"passes": n, "psnr": value} for n, value in mean_curve.items()],
    )
    table = pd.DataFrame(rows)
    write_text(work.root / "tables" / f"quality_{scene_name}.csv", table.to_csv(index=False))


def _check_layers(
    work: Workspace,
    name: str,
    layers: dict[str, np.ndarray],
    reference: np.ndarray,
    passes: list[int],
) -> None:
    """Refuse images that were made with other parameters than the references."""
    for layer in ("gpf", *(f"sppm_{n}" for n in passes)):
        path = work.render("gpf", name) if layer == "gpf" else work.ceiling(name)
        stages = "`gpf stage reference` and `gpf stage render`"
        if layer not in layers:
            raise UserError(str(path), f"has no layer {layer}", f"Run {stages} again.")
        if layers[layer].shape != reference.shape:
            raise UserError(
                str(path),
                f"has {layers[layer].shape[1]}x{layers[layer].shape[0]} pixels, its reference "
                f"{reference.shape[1]}x{reference.shape[0]}",
                f"Run {stages} again.",
            )
        check_finite(layers[layer], str(path))


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if len(known) == len(values) else None
