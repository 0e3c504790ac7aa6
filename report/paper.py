"""The numbers that the paper reports, from paper.yaml. All other numbers are measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from statistics import fmean
from typing import Any, Literal

from gpf.core.settings import Positive, Settings
from gpf.core.yaml import read_yaml

FILE = Path(__file__).with_suffix(".yaml")

Group = Literal["components", "gaussians", "k"]


class Numbers(Settings):
    """Metrics of a method's images (PSNR in dB), its storage in MB and its seconds per view."""

    psnr: Positive
    ssim: Positive
    lpips: Positive
    storage_mb: Positive | None = None
    seconds_per_view: Positive | None = None

    @property
    def known(self) -> dict[str, float]:
        """The numbers that the paper gives."""
        return {key: getattr(self, key) for key in _NUMBERS if getattr(self, key) is not None}


_NUMBERS = ("psnr", "ssim", "lpips", "storage_mb", "seconds_per_view")


class Variant(Numbers):
    """A row of an ablation: its title, and the settings of its field."""

    title: str
    field: dict[str, Any]


class Ablations(Settings):
    """Tables 3, S1 and S2, all of one scene."""

    scene: str
    components: tuple[Variant, ...]
    gaussians: tuple[Variant, ...]
    k: tuple[Variant, ...]

    def of(self, group: str) -> Sequence[Variant]:
        """The rows of a table; none for a group that the paper does not have."""
        return getattr(self, group) if group in Group.__args__ else ()  # type: ignore[attr-defined]


class Cost(Settings):
    """Hours of preparation, and the number of views at which they pay off."""

    total_hours: Positive
    break_even_views: int


class Paper(Settings):
    """All numbers of the paper: scene -> method -> numbers.

    Scenes have this project's names. :meth:`name_of` finds the paper's name for a method.
    """

    methods: dict[str, dict[str, Any]]
    systems: dict[str, dict[str, Numbers]]
    mean: dict[str, Numbers]
    learned: dict[str, dict[str, Numbers]]
    seconds: dict[str, dict[str, Positive]]
    ablations: Ablations
    cost: Cost

    def name_of(self, options: Mapping[str, Any]) -> str:
        """The paper's name for a method with these settings; "" if the paper lacks it."""
        alike = (
            name
            for name, settings in self.methods.items()
            if all(options.get(key) == value for key, value in settings.items())
        )
        return next(alike, "")

    def quality(self, scene: str, method: str) -> dict[str, float]:
        """A method's PSNR, SSIM, LPIPS and storage in a scene, as far as reported."""
        for table in (self.systems, self.learned):
            if method in table.get(scene, {}):
                return table[scene][method].known
        return {}

    def mean_over(self, scenes: Sequence[str], method: str) -> dict[str, float]:
        """The means over these scenes: the printed means for all five scenes, else the means of the
        printed numbers. A number that is missing in a scene has no mean."""
        if set(scenes) == set(self.systems):
            return self.mean[method].known if method in self.mean else {}
        rows = [self.quality(scene, method) for scene in scenes]
        keys: Mapping[str, float] = rows[0] if rows else {}
        return {
            key: fmean(row[key] for row in rows) for key in keys if all(key in row for row in rows)
        }

    def time(self, scene: str, method: str) -> float | None:
        """Seconds per image, if reported."""
        return self.seconds.get(method, {}).get(scene)


@cache
def read_paper() -> Paper:
    """The paper's numbers."""
    return read_yaml(FILE, Paper, "It is part of the package `report`: reinstall that.")
