"""The files of all stages, from which all tables, figures and pages are made.

Nothing is rendered or timed here: a number that no file has is missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from baselines.options import BaselineOptions
from gpf.core.files import read_json
from gpf.scene.views import SceneViews, read_views
from metrics.files import CostFile, Judged, NotJudged, Point
from metrics.image import NUMBERS
from metrics.stage_costs import passes_done, seconds_per_view, target_seconds
from stages.config.params import Params, read_params
from stages.config.pipeline import OWN_METHODS
from stages.config.titles import method_titles, passes_title

FIELD, SECOND_REFERENCE = OWN_METHODS
"""The two methods without a row in `baselines`: the field and the second reference."""


@dataclass(frozen=True)
class Results:
    """The results of all scenes.

    Attributes
    ----------
    params: the current params.yaml.
    root: the folder ``results``.
    """

    params: Params
    root: Path = Path("results")

    @classmethod
    def open(cls, root: Path = Path("results")) -> Results:
        """The results below the working directory."""
        return cls(read_params(), root)

    @cached_property
    def scenes(self) -> list[str]:
        """Measured scenes of params.yaml, in its order, whose references have the number of passes
        that it asks for."""
        return [s for s in self.params.scenes if self.has_metrics(s) and self.is_current(s)]

    def has_metrics(self, scene: str) -> bool:
        """Whether the stage `metrics` has run for the scene."""
        return (self.root / scene / "metrics").is_dir()

    def is_current(self, scene: str) -> bool:
        """Whether the references have the number of passes that params.yaml asks for, as far as
        known. It may differ after a change of profile."""
        section, passes = self.params.reference, max(self.scene(scene).convergence, default=None)
        if passes is None or passes == section.passes:
            return True
        return section.target_psnr > 0 and passes < section.passes

    @property
    def methods(self) -> dict[str, str]:
        """Titles of all methods that params.yaml asks for: baselines, field, second reference."""
        titles = method_titles(self.params)
        return {m: titles[m] for m in (*self.params.methods.all, FIELD, SECOND_REFERENCE)}

    @property
    def passes(self) -> str:
        """The number of passes of the references, as text."""
        return passes_title(self.params.reference)

    @property
    def unmeasured(self) -> list[str]:
        """The other scenes of params.yaml: not measured, or with other references."""
        return [s for s in self.params.scenes if s not in self.scenes]

    def methods_of(self, scene: str) -> dict[str, str]:
        """Titles of the methods that can have numbers in a scene. Rows of `baselines` that
        `methods` does not list are included; rows for other scenes are not."""
        rows = self.params.baselines
        known = dict.fromkeys([*self.params.methods.all, *rows])
        meant = [m for m in known if not rows[m].scenes or scene in rows[m].scenes]
        titles = method_titles(self.params)
        return {m: titles[m] for m in (*meant, FIELD, SECOND_REFERENCE)}

    def scene(self, name: str) -> SceneResults:
        """The files of one scene."""
        return SceneResults(name, self.root / name)

    def options(self, method: str) -> dict[str, Any]:
        """A method's settings: its row of `baselines`; for the field its samples per pixel, and for
        the second reference its passes."""
        if method == FIELD:
            return {"system": FIELD, "spp": self.params.render.spp}
        if method == SECOND_REFERENCE:
            return {"system": SECOND_REFERENCE, "passes": self.params.reference.passes}
        return self.params.baselines[method].model_dump(mode="json")

    def row(self, scene: str, method: str) -> dict[str, float]:
        """The known numbers of a method in a scene, from :attr:`quality`."""
        frame = self.quality
        found = frame[(frame["scene"] == scene) & (frame["method"] == method)]
        if found.empty:
            return {}
        numbers = found.iloc[0].drop(["scene", "method", "title", "reason"]).dropna()
        return {str(key): float(value) for key, value in numbers.items()}

    def reasons(self, scene: str, method: str) -> dict[str, str]:
        """Why numbers are missing, by name; under "" if the method has no numbers at all."""
        if method not in self.methods:
            return {"": "not listed in `methods` of params.yaml"}
        why = self.scene(scene).numbers(method).get("reason")
        return {"": str(why)} if why else self.scene(scene).gaps(method)

    @cached_property
    def quality(self) -> pd.DataFrame:
        """A row per scene and method. Unknown values are NaN.

        Columns: ``scene``, ``method``, ``title``; the means of :data:`NUMBERS` over novel views;
        ``storage_mb``, ``memory_mb``, ``prepare_seconds``, ``seconds_per_view``; the timing
        baseline ``path_seconds`` (a view by ``path`` with max_depth 2 and one sample per pixel,
        measured in the same run); ``reason``, why there are no numbers.
        """
        rows = []
        for name in self.scenes:
            scene = self.scene(name)
            for method, title in self.methods.items():
                numbers = scene.numbers(method) | scene.cost(method, self.params)
                rows.append({"scene": name, "method": method, "title": title} | numbers)
        costs = ("storage_mb", "memory_mb", "prepare_seconds", "seconds_per_view", "path_seconds")
        columns = ["scene", "method", "title", *NUMBERS, *costs, "reason"]
        frame = pd.DataFrame(rows, columns=columns)
        numeric = [*NUMBERS, *costs]
        return frame.astype(dict.fromkeys(numeric, "float64"))


@dataclass(frozen=True)
class SceneResults:
    """The files of one scene."""

    name: str
    folder: Path

    def read(self, *parts: str, shape: Any = dict[str, Any]) -> Any:
        """A JSON file below the scene's folder; empty if it does not exist.

        ``shape``: as for :func:`gpf.core.files.read_json`.
        """
        path = self.folder.joinpath(*parts)
        return read_json(path, shape) if path.exists() else {}

    @property
    def title(self) -> str:
        """The scene's name in words: `Cornell Box`."""
        return self.name.replace("_", " ").title()

    @cached_property
    def views(self) -> SceneViews:
        """Its cameras."""
        return read_views(self.folder / "views.yaml")

    def image(self, method: str, view: str) -> Path:
        """The file of a method's image of a view; `reference` counts as a method here."""
        if method in ("reference", SECOND_REFERENCE):
            return self.folder / method / f"{view}.exr"
        return self.folder / "renders" / method / f"{view}.exr"

    def numbers(self, method: str) -> dict[str, Any]:
        """A method's means over the novel views, or the ``reason`` why there are none."""
        found = self.read("metrics", f"{method}.json", shape=Judged | NotJudged)
        if not found:
            return {"reason": "not run"}
        if "cannot_serve" in found:
            return {"reason": found["cannot_serve"]}
        return dict(found["mean"])

    def gaps(self, method: str) -> dict[str, str]:
        """Why some metrics of a method's images are missing, by name."""
        return dict(self.read("metrics", f"{method}.json").get("reasons", {}))

    @cached_property
    def convergence(self) -> dict[int, float]:
        """Number of SPPM passes -> PSNR against the reference, dB, mean over novel views."""
        rows = self.read("convergence.json", shape=list[Point])
        return {row["passes"]: row["psnr"] for row in rows}

    @cached_property
    def seconds_per_pass(self) -> float | None:
        """Seconds that an SPPM pass takes for a single view."""
        facts = self.read("costs", "reference.json", shape=CostFile).get("facts", {})
        seconds = facts.get("seconds_per_single_view_pass")
        return None if seconds is None else float(seconds)

    @cached_property
    def ablations(self) -> dict[str, Mapping[str, Any]]:
        """Variant -> the file that the stage `ablation` wrote."""
        files = sorted(self.folder.glob("ablations/*.json"))
        return {file.stem: self.read("ablations", file.name) for file in files}

    def cost(self, method: str, params: Params) -> dict[str, float]:
        """The known costs of a method, with the column names of :attr:`Results.quality`."""
        if method == SECOND_REFERENCE:
            per_pass = self.seconds_per_pass
            passes = max(self.convergence, default=params.reference.passes)
            return {"seconds_per_view": per_pass * passes} if per_pass else {}
        file = "render.json" if method == FIELD else f"baselines/{method}.json"
        found = self.read("costs", file, shape=CostFile)
        facts, parts = found.get("facts", {}), found.get("parts", {})
        known = {
            "storage_mb": facts.get("storage_megabytes", facts.get("field_megabytes")),
            "memory_mb": facts.get("peak_memory_megabytes"),
            "path_seconds": facts.get("path_seconds"),
        }
        if "views" in facts and "render" in parts:
            known["seconds_per_view"] = seconds_per_view(found)
        if method == FIELD:
            trained = self.read("costs", "train.json", shape=CostFile).get("facts", {})
            memory = [f.get("peak_memory_megabytes") for f in (facts, trained)]
            known["memory_mb"] = max((m for m in memory if m is not None), default=None)
        if method == FIELD or params.baselines[method].renders_field:
            known["prepare_seconds"] = self.read("amortize.json").get("preparation_seconds")
        elif "prepare" in parts:
            inputs = self.inputs_seconds(params.baselines[method], params.reference.passes)
            if inputs is not None:
                known["prepare_seconds"] = inputs + parts["prepare"]["wall_seconds"]
        return {key: value for key, value in known.items() if value is not None}

    def inputs_seconds(self, options: BaselineOptions, passes: int) -> float | None:
        """Seconds to compute a system's training data: targets, or references of training views.

        The views are rendered together from the same photons, with ``passes`` passes or, with
        `reference.target_psnr`, as many as were done. None if these times were not measured.
        """
        cost, seconds = self.read("costs", "reference.json", shape=CostFile), 0.0
        try:
            passes = passes_done(cost, "train", passes)
            if options.training_views:
                per_pass = float(cost["facts"]["seconds_per_shared_view_pass"])
                seconds = options.training_views * passes * per_pass
            if options.learns_from_targets:
                seconds += target_seconds(cost, passes)
        except KeyError:
            return None
        return seconds
