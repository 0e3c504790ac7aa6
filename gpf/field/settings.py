"""How a field is queried: the settings that its file keeps."""

from __future__ import annotations

from typing import Annotated, Literal

import mitsuba as mi
from pydantic import Field

from gpf.core.settings import Positive, Settings
from gpf.scene.lamps import Lamps

Direct = Literal["field", "emitters"] | tuple[int, ...]
"""Source of direct light: the ``field``, like all other light; a sample of the ``emitters`` at the
visible point, so that the field stores indirect light only; or such a sample for only some of the
emitters, given by their indices in ``scene.emitters()``."""


def sampled_lamps(scene: mi.Scene, direct: Direct) -> Lamps:
    """The emitters whose direct light is sampled when a view is rendered."""
    if direct == "emitters":
        return Lamps(scene)
    return Lamps(scene, () if direct == "field" else direct)


class FieldSettings(Settings):
    """How a field is queried.

    Attributes
    ----------
    search_radius: radius r of the ball, world units.
    k: if the ball holds at most k Gaussians, the k nearest are used instead.
    neighbours: ``both``: as described under k; ``radius``: the ball alone; ``knn``: the k nearest
        alone.
    blend: ``divided`` by the sum of weights, or the plain ``sum``.
    stores: ``irradiance`` (multiplied by the reflectance / π at the hit) or ``radiance``.
    direct: source of direct light (:data:`Direct`).
    normal_test: whether to ignore Gaussians of another surface: with normals more than 45° apart,
        or farther from the plane than :data:`gpf.field.limits.SURFACE_HEIGHT`.
    """

    search_radius: Positive
    k: Annotated[int, Field(ge=1, le=32)] = 3
    neighbours: Literal["both", "radius", "knn"] = "both"
    blend: Literal["divided", "sum"] = "divided"
    stores: Literal["irradiance", "radiance"] = "irradiance"
    direct: Direct = "field"
    normal_test: bool = True

    def sampled_lamps(self, scene: mi.Scene) -> Lamps:
        """The emitters whose direct light is sampled when a view is rendered."""
        return sampled_lamps(scene, self.direct)
