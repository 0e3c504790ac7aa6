"""Stage `metrics`: images -> numbers, by one protocol for every method."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import pandas as pd

from gpf.artifacts import write_json, write_text
from gpf.errors import UserError
from gpf.images import check_finite, read_exr
from metrics.image import compare, flip_exposures, psnr
from metrics.worth import snapshot_passes, worth_passes
from stages.costs import CostMeter
from stages.progress import progress_bar
from stages.workspace import Workspace

NUMBERS = ("psnr", "ssim", "lpips", "flip", "flip_hdr", "relmse")


def compare_images(scene_name: str) -> None:
    """Compare the field and SPPM at several pass counts with the references."""
    work = Workspace.open(scene_name)
    exposure = work.views.exposure
    epsilon = work.params.metrics.relmse_epsilon
    names = [view.name for view in work.views.novel]
    references, cameras = {}, {}
    for name in names:
        layers, record = read_exr(work.reference(name), "reference")
        references[name], cameras[name] = layers["radiance"], record["view"]
    for name, image in references.items():
        check_finite(image, str(work.reference(name)))
    passes = snapshot_passes(work.params.reference.passes)
    # Method -> layer of the ceiling's EXR, or the field's own image.
    methods = {"gpf": "gpf", "sppm_3": "sppm_3", "ceiling": f"sppm_{passes[-1]}"}
    exposures: tuple[float, float] | tuple[None, None] = (None, None)
    # All black: HDR-FLIP of each image says why it is missing.
    with suppress(ValueError):
        exposures = flip_exposures(list(references.values()))

    results: dict[str, Any] = {method: {} for method in methods}
    curves: dict[str, dict[int, float]] = {}
    costs = CostMeter()
    title = f"{scene_name}: metrics"
    with progress_bar(title, len(names)) as advance, costs.measure("metrics"):
        for done, name in enumerate(names, start=1):
            layers, _ = read_exr(work.ceiling(name), "reference")
            rendered, record = read_exr(work.render("gpf", name), "render")
            layers["gpf"] = rendered["radiance"]
            _check_views(work, name, cameras[name], record["view"])
            _check_layers(work, name, layers, references[name], passes)
            for method, layer in methods.items():
                results[method][name] = compare(
                    layers[layer], references[name], exposure, exposures[0], exposures[1], epsilon
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
    costs.write(work.cost("metrics"))
    table = pd.DataFrame(rows)
    write_text(work.root / "tables" / f"quality_{scene_name}.csv", table.to_csv(index=False))


def _check_views(work: Workspace, name: str, reference: object, rendered: object) -> None:
    """Refuse a reference or a render of another camera than views.yaml has."""
    wanted = work.views.find(name).model_dump(mode="json")
    for stage, found in (("reference", reference), ("render", rendered)):
        if found != wanted:
            path = work.reference(name) if stage == "reference" else work.render("gpf", name)
            raise UserError(
                str(path), "was made with another camera", f"Run `gpf stage {stage}` again."
            )


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
