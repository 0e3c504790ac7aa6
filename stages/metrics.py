"""Stage `metrics`: compare the images of all methods with the references, in the same way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gpf.core.errors import FileError, UserError
from gpf.core.files import read_json, write_json, write_text
from gpf.core.images import check_finite, read_exr
from gpf.core.progress import progress_bar, say
from metrics.equivalent_passes import equivalent_passes
from metrics.files import Refusal
from metrics.image import NUMBERS, compare, flip_exposures, psnr
from stages.common.costs import CostMeter
from stages.common.makers import command_for
from stages.common.workspace import Workspace

SECOND_REFERENCE = "second_reference"


def run(scene_name: str) -> None:
    """Compare the field, the rows of `methods` and the second reference with the references.

    Methods without images of the scene are left out; a message names the command to render them.
    """
    work = Workspace.open(scene_name)
    judge = Judge.open(work)
    names, references = list(judge.references), judge.references
    refused = {m: reason for m in work.params.methods.all if (reason := _refusal(work, m))}
    methods = _rendered(work, names, refused)
    passes = _snapshots_of_all(work, names) if SECOND_REFERENCE in methods else []
    results: dict[str, dict[str, Any]] = {method: {} for method in methods}
    curves: dict[str, dict[int, float]] = {}
    costs = CostMeter()
    title = f"{scene_name}: metrics"
    total = len(names) * len(methods)
    with progress_bar(title, total) as advance, costs.measure("metrics"):
        for name in names:
            snapshots = _read_snapshots(work, name, references[name], passes) if passes else []
            curves[name] = {
                n: psnr(image, references[name], work.views.exposure) for n, image in snapshots
            }
            for method in methods:
                results[method][name] = (
                    judge.compare(name, snapshots[-1][1])
                    if method == SECOND_REFERENCE
                    else judge.compare_render(method, name)
                )
                advance(sum(map(len, results.values())))

    rows, summaries = [], {}
    for method, views in results.items():
        report = summarize(views)
        summary = report["mean"]
        if method == "gpf" and passes:
            report["equivalent_sppm_passes"] = {
                name: str(equivalent_passes(views[name]["psnr"], curves[name])) for name in names
            }
        write_json(work.metrics(method), report)
        summaries[method] = summary
        rows.append({"scene": scene_name, "method": method, **summary})
    for method, reason in refused.items():
        write_json(work.metrics(method), {"cannot_serve": reason})
        rows.append({"scene": scene_name, "method": method, "reason": reason})
    _remove_others(work, (*methods, *refused))
    write_json(work.summary, summaries)
    mean_curve = {n: float(np.mean([curves[name][n] for name in names])) for n in passes}
    write_json(
        work.convergence,
        [{"passes": n, "psnr": value} for n, value in mean_curve.items()],
    )
    costs.write(work.cost("metrics"))
    table = pd.DataFrame(rows, columns=["scene", "method", *NUMBERS, "reason"])
    write_text(work.folder / "quality.csv", table.to_csv(index=False))


@dataclass(frozen=True)
class Judge:
    """The references of a scene's novel views and the settings of the comparison.

    Attributes
    ----------
    references: view -> radiance, (H, W, 3).
    exposures: first and last exposure of HDR-FLIP in stops; None if all references are black.
    """

    work: Workspace
    references: Mapping[str, np.ndarray]
    exposures: tuple[float, float] | tuple[None, None]

    @classmethod
    def open(cls, work: Workspace) -> Judge:
        """Read the references; raises a :class:`UserError` if there are no novel views."""
        names = [view.name for view in work.novel_views()]
        references = {name: _read_reference(work, name) for name in names}
        exposures: tuple[float, float] | tuple[None, None] = (None, None)
        # If all are black, `compare` stores the reason in place of HDR-FLIP.
        with suppress(ValueError):
            exposures = flip_exposures(list(references.values()))
        return cls(work, references, exposures)

    def compare(self, view: str, image: np.ndarray) -> dict[str, Any]:
        """All metrics of an image of a view, and the reasons for missing ones."""
        exposure, epsilon = self.work.views.exposure, self.work.params.metrics.relmse_epsilon
        first, last = self.exposures
        return {**compare(image, self.references[view], exposure, first, last, epsilon)}

    def compare_render(self, method: str, view: str) -> dict[str, Any]:
        """All metrics of a method's image of a view."""
        return self.compare(view, _read_render(self.work, method, view, self.references[view]))


def summarize(views: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The metrics of all views, their means, and the reasons for missing ones."""
    mean = {key: _mean([numbers[key] for numbers in views.values()]) for key in NUMBERS}
    reasons = {k: v for numbers in views.values() for k, v in numbers["reasons"].items()}
    return {"mean": mean, "views": views, "reasons": reasons}


def _refusal(work: Workspace, method: str) -> str | None:
    """Why a method cannot render the scene, or None if it can or was not run."""
    file = work.refusal(method)
    if not file.exists():
        return None
    reason: str = read_json(file, Refusal)["reason"]
    return reason


def _rendered(work: Workspace, views: Sequence[str], refused: Mapping[str, str]) -> list[str]:
    """The methods that have images of the scene; prints a message for each one that has none."""
    found = []
    for method in ("gpf", *work.params.methods.all, SECOND_REFERENCE):
        if method in refused:
            continue
        paths = [
            work.second_reference(view) if method == SECOND_REFERENCE else work.render(method, view)
            for view in views
        ]
        if any(path.exists() for path in paths):
            found.append(method)
        else:
            command = command_for(paths[0])
            say(f"{work.scene}: {method} has no images and is left out; `{command}` renders them")
    return found


def _remove_others(work: Workspace, methods: Sequence[str]) -> None:
    """Remove the numbers of other methods: those no longer in params.yaml, or without images."""
    for path in work.metrics("gpf").parent.glob("*.json"):
        if path.stem not in methods:
            path.unlink()


def _read_reference(work: Workspace, name: str) -> np.ndarray:
    path = work.reference(name)
    layers, record = read_exr(path)
    _check_view(work, path, name, record)
    check_finite(layers["radiance"], str(path))
    return layers["radiance"]


def _snapshots_of_all(work: Workspace, views: Sequence[str]) -> list[int]:
    """Numbers of passes at which the second reference has images of all views.

    The last is `reference.passes`, or fewer if `reference.target_psnr` was reached.

    Raises
    ------
    UserError: the second reference was rendered with another `reference.passes`, or has no images.
    """
    files = {name: read_exr(work.second_reference(name)) for name in views}
    wanted = work.params.reference.passes
    for name, (_, record) in files.items():
        if record.get("passes") != wanted:
            raise UserError(
                str(work.second_reference(name)),
                f"has {record.get('passes', 'unknown')} passes, but params.yaml asks for {wanted}",
                f"Run `{command_for(work.second_reference(name))}` again, or set reference.passes "
                "back.",
            )
    names = set.intersection(*(set(layers) for layers, _ in files.values()))
    passes = sorted(int(n) for n in (s.removeprefix("sppm_") for s in names) if n.isdecimal())
    if not passes:
        raise FileError(work.second_reference(views[0]), "shares no layer sppm_N with other views")
    return passes


def _read_snapshots(
    work: Workspace, name: str, reference: np.ndarray, passes: list[int]
) -> list[tuple[int, np.ndarray]]:
    """The second reference's image of a view at each number of passes."""
    path = work.second_reference(name)
    layers, _ = read_exr(path)
    for n in passes:
        _check_image(work, path, layers[f"sppm_{n}"], reference)
    return [(n, layers[f"sppm_{n}"]) for n in passes]


def _read_render(work: Workspace, method: str, name: str, reference: np.ndarray) -> np.ndarray:
    """A method's image of a view."""
    path = work.render(method, name)
    layers, record = read_exr(path)
    _check_view(work, path, name, record)
    _check_image(work, path, layers["radiance"], reference)
    return layers["radiance"]


def _check_view(work: Workspace, path: Path, name: str, record: Mapping[str, Any]) -> None:
    """Raise an error if the image was made with a camera other than the one in views.yaml."""
    if record.get("view") != work.views.find(name).model_dump(mode="json"):
        raise UserError(
            str(path), "was made with another camera", f"Run `{command_for(path)}` again."
        )


def _check_image(work: Workspace, path: Path, image: np.ndarray, reference: np.ndarray) -> None:
    """Raise an error if the image does not have the size of its reference, or is not finite."""
    if image.shape != reference.shape:
        raise UserError(
            str(path),
            f"has {image.shape[1]}x{image.shape[0]} pixels, but its reference "
            f"has {reference.shape[1]}x{reference.shape[0]}",
            f"Run `{command_for(work.reference(path.stem))}` and `{command_for(path)}` again.",
        )
    check_finite(image, str(path))


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if len(known) == len(values) else None
