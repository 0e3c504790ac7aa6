"""What the stages left in their files: the one source of every table, figure and page.

Nothing here computes a picture or a time: what no file has is missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from gpf.artifacts import read_json
from gpf.config import Params, read_params
from gpf.views import SceneViews, read_views

NUMBERS = ("psnr", "ssim", "lpips", "flip", "flip_hdr", "relmse")
"""What is known of an image, as `gpf stage metrics` names it."""

FIELD, CEILING = "gpf", "ceiling"
"""Methods without a row in `baselines`: the field, and a second, independent reference."""


@dataclass(frozen=True)
class Results:
    """The files below a folder ``results``.

    Attributes
    ----------
    params: what params.yaml says now.
    root: the folder.
    """

    params: Params
    root: Path = Path("results")

    @classmethod
    def open(cls, root: Path = Path("results")) -> Results:
        """The results of the project in the working directory."""
        return cls(read_params(), root)

    @property
    def scenes(self) -> list[str]:
        """Scenes of params.yaml that have been measured, in its order."""
        return [s for s in self.params.scenes if (self.root / s / "metrics").is_dir()]

    @property
    def methods(self) -> dict[str, str]:
        """All methods that params.yaml asks for, with their titles: baselines, field, ceiling."""
        rows = {m: self.params.baselines[m].title for m in self.params.methods.all}
        field = f"GPF, {self.params.render.spp} spp"
        return rows | {FIELD: field, CEILING: f"SPPM, {self.params.reference.passes} passes"}

    def scene(self, name: str) -> SceneResults:
        """The files of one scene."""
        return SceneResults(name, self.root / name)

    @cached_property
    def quality(self) -> pd.DataFrame:
        """A row per scene and method: columns ``scene``, ``method``, ``title``, the mean of each
        of :data:`NUMBERS` over novel views, ``storage_mb``, ``memory_mb``, ``prepare_seconds``,
        ``seconds_per_view``, ``path_seconds`` (a view by ``path`` with max_depth 2 and one sample
        per pixel, in the same run) and ``reason``: why there are no numbers. What is unknown is
        missing (NaN)."""
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
    """What is known of one scene."""

    name: str
    folder: Path

    def read(self, *parts: str) -> Mapping[str, Any]:
        """A JSON file below the scene's folder; empty where it does not exist."""
        path = self.folder.joinpath(*parts)
        return read_json(path, "report") if path.exists() else {}

    @cached_property
    def views(self) -> SceneViews:
        """Its cameras."""
        return read_views(self.folder / "views.yaml")

    def image(self, method: str, view: str) -> Path:
        """Where a method's image of a view is; `reference` counts as a method here."""
        if method in ("reference", CEILING):
            return self.folder / method / f"{view}.exr"
        return self.folder / "renders" / method / f"{view}.exr"

    def numbers(self, method: str) -> dict[str, Any]:
        """A method's means over the novel views, or the ``reason`` why there are none."""
        found = self.read("metrics", f"{method}.json")
        if not found:
            return {"reason": "not run"}
        if "cannot_serve" in found:
            return {"reason": found["cannot_serve"]}
        return dict(found["mean"])

    def cost(self, method: str, params: Params) -> dict[str, float]:
        """Seconds, megabytes: the columns of :attr:`Results.quality` that are known."""
        if method == CEILING:
            facts = self.read("costs", "reference.json").get("facts", {})
            per_pass = facts.get("seconds_per_single_view_pass")
            return {"seconds_per_view": per_pass * params.reference.passes} if per_pass else {}
        found = self.read("costs", *_COSTS.get(method, ("baselines", f"{method}.json")))
        facts, parts = found.get("facts", {}), found.get("parts", {})
        known = {
            "storage_mb": facts.get("storage_megabytes", facts.get("field_megabytes")),
            "memory_mb": facts.get("peak_memory_megabytes"),
            "path_seconds": facts.get("path_seconds"),
        }
        if facts.get("views"):
            known["seconds_per_view"] = parts["render"]["wall_seconds"] / facts["views"]
        if method == FIELD:
            known["prepare_seconds"] = self.read("amortize.json").get("preparation_seconds")
        elif "prepare" in parts:
            known["prepare_seconds"] = parts["prepare"]["wall_seconds"]
        return {key: value for key, value in known.items() if value is not None}


_COSTS = {FIELD: ("render.json",)}
