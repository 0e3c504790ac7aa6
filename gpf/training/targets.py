"""What training learns from: surface points with their irradiance, from views and surfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import mitsuba as mi
import numpy as np

from gpf.core.errors import FileError, UserError
from gpf.core.files import read_tensors, write_tensors
from gpf.core.structs import SurfacePoints

Loss = Literal["squared", "relative"]

# The source of a target that comes from a sample of the scene's surfaces, not from a view.
SURFACE = -1


@dataclass(frozen=True)
class Targets:
    """Supervised points, as numpy arrays of P rows.

    Attributes
    ----------
    position, normal: world units and unit vectors, (P, 3).
    irradiance: the target E, W/m², (P, 3).
    direct: the part of the irradiance that came from samples of the emitters; 0 where photons
        brought all of it, (P, 3).
    reflectance: diffuse reflectance at the point; 1 for surface samples, (P, 3).
    source: number of the training view that sees the point, or :data:`SURFACE`, (P,).
    """

    position: np.ndarray
    normal: np.ndarray
    irradiance: np.ndarray
    direct: np.ndarray
    reflectance: np.ndarray
    source: np.ndarray

    @classmethod
    def from_view(cls, layers: Mapping[str, np.ndarray], number: int) -> Targets:
        """Targets of one view, from the layers of its reference, in image order."""
        valid = layers["valid"] > 0.5
        names = ("position", "normal", "irradiance", "direct", "reflectance")
        source = np.full(int(valid.sum()), number, np.int32)
        return cls(**{name: layers[name][valid] for name in names}, source=source)

    @classmethod
    def from_surfaces(cls, tensors: Mapping[str, np.ndarray]) -> Targets:
        """Targets at samples of the scene's surfaces."""
        position = tensors["position"]
        ones = np.ones_like(position)
        source = np.full(len(position), SURFACE, np.int32)
        names = ("position", "normal", "irradiance", "direct")
        return cls(**{name: tensors[name] for name in names}, reflectance=ones, source=source)

    @staticmethod
    def join(parts: Sequence[Targets]) -> Targets:
        """All parts, one after the other."""
        names = [f.name for f in fields(Targets)]
        return Targets(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names})

    def save(self, path: Path) -> None:
        """Write the targets."""
        write_tensors(path, "targets", {k: v for k, v in vars(self).items()}, {})

    @classmethod
    def load(cls, path: Path) -> Targets:
        """Read targets."""
        tensors, _ = read_tensors(path, "targets")
        missing = {f.name for f in fields(cls)} - set(tensors)
        if missing:
            raise FileError(
                path,
                f"is from an earlier version: it has no {', '.join(sorted(missing))}",
            )
        return cls(**tensors)

    def select(self, points: Literal["views", "surface", "both"]) -> Targets:
        """The targets that come from views, from surfaces, or all."""
        if points == "both":
            return self
        rows = (self.source == SURFACE) == (points == "surface")
        return Targets(**{name: value[rows] for name, value in vars(self).items()})

    def supervised_points(
        self,
        points: Literal["views", "surface", "both"],
        stores: Literal["irradiance", "radiance"],
        loss: Loss,
        direct: Literal["field", "emitters"] = "field",
    ) -> SurfacePoints:
        """Points as training takes them.

        ``stores`` chooses what the field is to answer: E, or the outgoing radiance ρ/π E, for
        which only views know ρ. With ``direct`` from the emitters, direct light is none of E.
        ``loss`` chooses the points' weights (:func:`loss_weights`).
        """
        chosen = self.select("views" if stores == "radiance" else points)
        if len(chosen.position) == 0:
            raise UserError(
                f"train.points: {points}",
                f"selects none of {len(self.position)} targets",
                "Choose another, or have targets on surfaces.",
            )
        target = chosen.irradiance
        if direct == "emitters":
            target = np.maximum(target - chosen.direct, 0)
        if stores == "radiance":
            target = target * chosen.reflectance / np.pi

        def columns(array: np.ndarray) -> np.ndarray:
            return np.ascontiguousarray(array.T, dtype=np.float32)

        return SurfacePoints(
            p=mi.Point3f(columns(chosen.position)),
            n=mi.Normal3f(columns(chosen.normal)),
            target=mi.Color3f(columns(target)),
            weight=mi.Float(loss_weights(target, loss)),
        )


def loss_weights(target: np.ndarray, loss: Loss) -> np.ndarray:
    """Weights of points in the loss, (P,), from their targets, (P, 3): all alike, or ``relative``,

    1 / (E² + mean(E)²), normalised to mean 1: what is dark counts too.
    """
    if loss == "squared":
        return np.ones(len(target), dtype=np.float32)
    level = target.mean(axis=1)
    weight = 1 / (level**2 + level.mean() ** 2)
    return np.asarray(weight / weight.mean(), dtype=np.float32)
