"""The sections `field` and `train` of params.yaml."""

from __future__ import annotations

from typing import Literal

from gpf.core.settings import AutoCount, Length
from gpf.field.io import Precision
from gpf.field.settings import Direct, FieldSettings
from gpf.training.settings import TrainingSettings

MAX_GAUSSIANS = 100_000
"""Largest number that ``gaussians: auto`` tries, as in the paper."""


def most_gaussians(gaussians: int | Literal["auto"]) -> int:
    """Upper limit of a number of Gaussians; with ``auto``, the largest that the search tries."""
    return MAX_GAUSSIANS if gaussians == "auto" else gaussians


class InitialFieldSettings(FieldSettings):
    """Settings of a field: its query, and how its Gaussians start.

    Attributes
    ----------
    gaussians: number M of Gaussians; ``auto``: several numbers are tried in short training runs.
    initialization: ``photons``: means and normals of M random photons; ``random``: means uniform in
        the scene's bounding box, each with the normal of the nearest photon.
    fill_gaps: whether to place some of the Gaussians where cameras look but few photons land.
    initial_colour: ``targets``: the mean of the targets around the Gaussian; ``density``: kernel
        estimate of E at the Gaussian; ``flux``: the photon's own power Φ.
    initial_scale: standard deviation of all axes, world units; ``auto``: :data:`TYPICAL_SCALE`.
    direct: as for the field; ``auto``: direct light of lamps of zero or small size
        is sampled when a view is rendered (:func:`gpf.scene.lamps.small_lamps`).
    search_radius: world units; ``auto``: about 16 Gaussians around a typical point.
    anisotropic: whether the three scales of a Gaussian may differ.
    precision: precision of the field's file.
    """

    gaussians: AutoCount = "auto"
    initialization: Literal["photons", "random"] = "photons"
    fill_gaps: bool = True
    initial_colour: Literal["targets", "density", "flux"] = "targets"
    initial_scale: Length = "auto"
    search_radius: Length = "auto"  # type: ignore[assignment]
    direct: Literal["auto"] | Direct = "field"  # type: ignore[assignment]
    anisotropic: bool = True
    precision: Precision = "float32"

    def query(self, search_radius: float) -> FieldSettings:
        """The settings of the query, with the given search radius, world units."""
        common = {name: getattr(self, name) for name in FieldSettings.model_fields}
        return FieldSettings(**common | {"search_radius": search_radius})


class FieldTrainingSettings(TrainingSettings):
    """Settings of the stage `train`.

    Attributes
    ----------
    supervision: targets from a finished ``reference``, or ``streaming`` while passes are traced.
    """

    supervision: Literal["reference", "streaming"] = "reference"
