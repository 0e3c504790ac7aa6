"""Targets of the training: points of views and surfaces, with their irradiance."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.files import (
    read_tensors,
    require_finite,
    require_scene,
    require_shapes,
)
from gpf.core.structs import SurfacePoints

SURFACES = "surfaces of the scene"
"""Name of the set of surface samples; the other sets of points have the names of views."""


def source_numbers(names: Iterable[str]) -> np.ndarray:
    """The numbers of sets of points in ``Targets.source``, int32: 0, 1, … for views, -1 for
    :data:`SURFACES`."""
    return np.array([-1 if name == SURFACES else k for k, name in enumerate(names)], np.int32)


@dataclass(frozen=True)
class Targets:
    """Supervised points, as numpy arrays of P rows.

    Attributes
    ----------
    position, normal: world units and unit vectors, (P, 3).
    irradiance: the target E, W/m², (P, 3).
    direct: the part of the irradiance from samples of the emitters, (P, 3); 0 if photons carry
        direct light.
    reflectance: diffuse reflectance at the point; 1 for surface samples, (P, 3).
    source: number of the training view that sees the point; -1 for surface samples, (P,) int32.
    """

    position: np.ndarray
    normal: np.ndarray
    irradiance: np.ndarray
    direct: np.ndarray
    reflectance: np.ndarray
    source: np.ndarray

    @classmethod
    def load(cls, path: Path, scene: str | None = None) -> Targets:
        """Read targets.

        Raises
        ------
        FileError: the file does not hold targets, or names another scene than ``scene``; an array
            is missing, has the wrong shape or type, or has values that are not finite.
        """
        tensors, metadata = read_tensors(path, "targets")
        if scene is not None:
            require_scene(path, metadata, scene)
        vectors = {f.name: (("P", 3), "f4") for f in fields(cls)}
        require_shapes(path, tensors, vectors | {"source": (("P",), "i4")})
        require_finite(path, tensors)
        return cls(**tensors)

    def select(self, points: Literal["views", "surface", "both"]) -> Targets:
        """The targets from views, from surfaces, or from both."""
        if points == "both":
            return self
        rows = (self.source < 0) == (points == "surface")
        return Targets(**{name: value[rows] for name, value in vars(self).items()})

    def supervised_points(
        self,
        points: Literal["views", "surface", "both"] = "both",
        stores: Literal["irradiance", "radiance"] = "irradiance",
        indirect: bool = False,
    ) -> SurfacePoints:
        """The points that a trainer learns from.

        Parameters
        ----------
        points: which targets to use.
        stores: what the field stores: E, or the outgoing radiance ρ/π E; the latter uses points of
            views only, because surface samples have no ρ.
        indirect: whether direct light is subtracted from E.

        Raises
        ------
        UserError: no target is left.
        """
        chosen = self.select("views" if stores == "radiance" else points)
        if len(chosen.position) == 0:
            raise UserError(
                "train.points",
                f"{points!r} selects none of {len(self.position)} targets",
                "Choose another, or set reference.surface_points above 0.",
            )
        target = chosen.irradiance
        if indirect:
            target = target - chosen.direct
        if stores == "radiance":
            target = target * chosen.reflectance / np.pi

        def columns(array: np.ndarray) -> np.ndarray:
            return np.ascontiguousarray(array.T, dtype=np.float32)

        return SurfacePoints(
            p=mi.Point3f(columns(chosen.position)),
            n=mi.Normal3f(columns(chosen.normal)),
            target=mi.Color3f(columns(target)),
        )
