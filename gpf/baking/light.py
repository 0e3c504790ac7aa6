"""The irradiance at points of surfaces: a field's, and that of the lamps which it leaves out."""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.images import check_finite
from gpf.core.random import pass_seed, stream_of
from gpf.core.structs import VisiblePoints, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.shared_query import query_shared
from gpf.rendering.field_renderer import WEAK_COVERAGE
from gpf.scene.lamps import Lamps
from gpf.sppm.fixed_points import FixedPoints

SAMPLES = 16
"""Samples of the lamps that the field leaves out, per point."""

AT_ONCE = 1 << 17
"""Points whose light is computed at once."""

MOST_WEAK = 0.001
"""The share of points without a warning."""

UNCOVERED = (
    "%.1f %% of the points lie where the field has learned nothing: no camera saw them, and few "
    "photons came there. They got the light of their surroundings, even through walls. Fit with "
    "cameras that see them (views.yaml) if they matter."
)

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Source:
    """A group of emitters, or all of them.

    Attributes
    ----------
    name: name of the group; empty for all emitters.
    field: a field of this light alone.
    lamps: those of the emitters whose direct light the field leaves out.
    """

    name: str
    field: GaussianPhotonField
    lamps: Lamps


@dataclass(frozen=True)
class BakedLight:
    """Irradiance at points.

    Attributes
    ----------
    groups: by the names of the groups, W/m², (P, 3) float32 each; a single one with an empty name
        if the field keeps no groups apart.
    known: whether the field knows anything about the light there, or a lamp reaches it, (P,).
    """

    groups: dict[str, np.ndarray]
    known: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """The irradiance from all groups, W/m², (P, 3) float32."""
        return np.asarray(np.sum([*self.groups.values()], axis=0, dtype=np.float32))


def list_sources(scene: mi.Scene, field: GaussianPhotonField) -> list[Source]:
    """The groups that a field keeps apart, or a single source for all of its light.

    Raises
    ------
    UserError: the field stores what cannot be baked, or belongs to a scene with other emitters.
    """
    if field.settings.stores != "irradiance":
        raise UserError(
            "The field",
            "stores radiance, which depends on the reflectances",
            "Bake a field that stores irradiance, as `gpf fit` makes them.",
        )
    sampled = field.settings.sampled_lamps(scene)
    if field.lights is None:
        return [Source("", field, sampled)]
    groups, sources = field.lights.groups, []
    if sum(map(len, groups.members)) != len(scene.emitters()):
        raise UserError(
            "lights", "in the field belong to another scene", "Fit the field to this scene."
        )
    for number, (name, members) in enumerate(zip(groups.names, groups.members, strict=True)):
        own = copy.copy(field)
        own.recolour(field.lights.irradiance[number])
        kept = [k for k in members if sampled.indices is None or k in sampled.indices]
        sources.append(Source(name, own, Lamps(scene, kept)))
    return sources


def bake_light(
    scene: mi.Scene,
    field: GaussianPhotonField,
    p: np.ndarray,
    n: np.ndarray,
    samples: int = SAMPLES,
    seed: int = 0,
    report: Callable[[int], object] = lambda done: None,
) -> BakedLight:
    """The irradiance at points of surfaces.

    Parameters
    ----------
    p, n: positions and unit normals on the side where light is gathered, (P, 3).
    samples: samples of the lamps that the field leaves out, per point.
    report: called with the number of points whose light is known so far.

    Raises
    ------
    UserError: as :func:`list_sources`, or a value is not finite.
    """
    sources = list_sources(scene, field)
    light = {source.name: np.zeros((len(p), 3), np.float32) for source in sources}
    known, covered = np.zeros(len(p), bool), np.zeros(len(p), bool)
    for number, first in enumerate(range(0, len(p), AT_ONCE)):
        part = slice(first, first + AT_ONCE)
        points = VisiblePoints.seen_directly(p[part], n[part])
        fixed = FixedPoints(scene, points)
        for source in sources:
            found, reach = _stored(source.field, points)
            if source.lamps:
                own = pass_seed(seed, number, stream_of(f"baked {source.name}"))
                found += fixed.mean_direct(source.lamps, samples, own)
            light[source.name][part] = found
            known[part] |= (reach < np.inf) | found.any(axis=1)
            covered[part] = reach <= WEAK_COVERAGE
        report(min(first + AT_ONCE, len(p)))
    for name, values in light.items():
        check_finite(values, f"light {name}".strip())
    if (weak := 1 - covered.mean()) > MOST_WEAK:
        log.warning(UNCOVERED, 100 * weak)
    return BakedLight(light, known)


def _stored(field: GaussianPhotonField, points: VisiblePoints) -> tuple[np.ndarray, np.ndarray]:
    """The field's irradiance at points, (P, 3), and how far it looked for it, (P,)."""
    value, reach = query_shared(field, points.p, points.n, points.valid, near=0)
    return np.maximum(to_numpy(value), 0), np.asarray(reach.numpy())
