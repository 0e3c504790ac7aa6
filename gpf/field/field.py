"""The Gaussian photon field: irradiance at any surface point, blended from nearby Gaussians."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.recordable import Recordable
from gpf.core.structs import VisiblePoints, from_numpy
from gpf.field.detail import Detail
from gpf.field.gaussians import Gaussians, whitening_rows
from gpf.field.lights import FieldLights
from gpf.field.neighbour_search import NeighbourSearch
from gpf.field.settings import FieldSettings

# Keeps the sum of weights above zero: if all Gaussians of a neighbourhood are too narrow to reach
# the query point, the blend becomes their plain mean instead of black.
WEIGHT_FLOOR = 1e-6

# Where the ball holds at most k Gaussians, the k nearest are blended instead (the supplement).
# Their falloff reaches zero slightly beyond the (k + 1)-th neighbour, so that weights stay above
# zero if all are equally far away. Without a (k + 1)-th neighbour, it reaches zero at
# SUPPLEMENT_REACH times the farthest distance.
SUPPLEMENT_SLACK = 1.0002
SUPPLEMENT_REACH = 1.5


def blend_weight(
    d: mi.Vector3f,
    rows: tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f],
    support2: mi.Float,
) -> mi.Float:
    """``w = ψ(|d|) (exp(-|M d|²/2) + ε)`` with ψ(t) = (1 - t²/R²)², zero at the distance R.

    ψ is zero where a Gaussian enters or leaves the neighbourhood, so that the blend is continuous.

    Parameters
    ----------
    d: offsets from the means, world units, (N, 3).
    rows: rows of M, (N, 3) each; see :func:`gpf.field.gaussians.whitening_rows`.
    support2: R², (N,).
    """
    u = mi.Vector3f(*(dr.dot(row, d) for row in rows))
    falloff = dr.square(dr.maximum(1 - dr.squared_norm(d) / support2, 0))
    return falloff * (dr.exp(-0.5 * dr.squared_norm(u)) + WEIGHT_FLOOR)


def supplement_support(distance2: list[mi.Float]) -> tuple[mi.Float, mi.Float]:
    """Squared distance of the farthest of the k nearest, and squared support R² of their falloff.

    ``distance2`` holds k + 1 squared distances, ascending; infinite where a neighbour is missing.
    """
    farthest2 = mi.Float(0)
    for distance in distance2[:-1]:
        farthest2 = dr.select(distance < dr.inf, distance, farthest2)
    beyond = distance2[-1]
    support2 = dr.select(
        beyond < dr.inf, beyond * SUPPLEMENT_SLACK, farthest2 * SUPPLEMENT_REACH**2
    )
    return farthest2, support2 + dr.epsilon(mi.Float)


# Dr.Jit's syntax has no comprehensions.


def zeros(count: int) -> list[mi.Vector4f]:
    """So many vectors of length 0."""
    return [mi.Vector4f(0) for _ in range(count)]


def add_all(values: list[Any], others: list[Any]) -> list[Any]:
    """The sums of two lists of arrays."""
    return [a + b for a, b in zip(values, others, strict=True)]


def divide_all(values: list[Any], by: mi.Float) -> list[Any]:
    """Arrays, divided by the same."""
    return [value / by for value in values]


def keep_where(active: mi.Bool, values: list[Any]) -> list[Any]:
    """Arrays, and 0 where not ``active``."""
    return [dr.select(active, value, 0) for value in values]


class GaussianPhotonField(Recordable):
    """Gaussians, and the query that blends them.

    The value at a point x on a surface is

        E(x) = Σ w_i c_i / Σ w_i,   i in N(x)
        N(x) = Ball(x, max(r, d_{k+1})),   d_{k+1} the distance of the (k + 1)-th nearest:

    the ball of radius r, or the k nearest Gaussians where the ball holds no more than k; Gaussians
    that end before x are left out (:mod:`gpf.field.limits`).

    Parameters
    ----------
    gaussians: (N).
    settings: settings of the query.
    bounds: corners of the scene's bounding box.
    record: facts about how the field was made, as JSON values; saved with it.
    detail: the levels of a field that is not equally fine everywhere. The positions and sizes of
        its Gaussians are in the unfolded space (:mod:`gpf.field.detail`).
    lights: the irradiance by groups of emitters; None if they are not kept apart.
    error: expected error around each Gaussian, relative to its irradiance, (N,)
        (:mod:`gpf.training.field_error`); None if unknown.
    limits: the planes at which the Gaussians end, (N, 3, 4), in the space of their centres
        (:mod:`gpf.field.limits`); None if nothing is near the surfaces.
    caustics: the part of the irradiance that rays from the surface to lamps and other diffuse
        surfaces do not bring, (N, 3); single ones may be negative, or above 1; None if unknown.

    Attributes
    ----------
    volume: the light in media (:class:`gpf.field.volume.VolumeField`), or None.
    vectors: several for each Gaussian, blended like the colours, (N, K, 4); None: no vectors.
    """

    READ = ("detail", "search", "volume", "_packets", "_parts", "_vectors")

    def __init__(
        self,
        gaussians: Gaussians,
        settings: FieldSettings,
        bounds: tuple[Any, Any],
        record: Mapping[str, Any] | None = None,
        detail: Detail | None = None,
        lights: FieldLights | None = None,
        error: np.ndarray | None = None,
        limits: np.ndarray | None = None,
        caustics: np.ndarray | None = None,
    ) -> None:
        self.settings = settings
        self.volume: Any = None
        self.vectors: np.ndarray | None = None
        self.limits = limits
        self.lights = lights
        self.bounds = bounds
        self.detail = detail
        self.record = dict(record or {})
        self.update(gaussians, error, caustics)

    def update(
        self,
        gaussians: Gaussians,
        error: np.ndarray | None = None,
        caustics: np.ndarray | None = None,
    ) -> None:
        """Take new Gaussians, their expected errors and the part of them that is caustics, and
        rebuild the neighbour search."""
        self.gaussians, self.error, self.caustics = gaussians, error, caustics
        bounds = self.bounds if self.detail is None else self.detail.bounds
        self.search = NeighbourSearch(gaussians, self.settings, bounds, self.limits)
        self._pack()

    def recolour(self, irradiance: np.ndarray) -> None:
        """Give the same Gaussians new colours, (N, 3); fast enough for sliders."""
        colour = from_numpy(mi.Color3f, irradiance)
        self.gaussians = dataclasses.replace(self.gaussians, irradiance=colour)
        self._pack()

    def _pack(self) -> None:
        """Put rows and colours next to each other, in the order of the search."""
        gaussians, order = self.gaussians, self.search.hash.order
        rows = whitening_rows(gaussians.log_scales, gaussians.quats)
        ordered = [dr.gather(mi.Vector3f, row, order) for row in rows]

        def packets(values: mi.Color3f) -> list[Any]:
            pairs = zip(ordered, dr.gather(mi.Color3f, values, order), strict=True)
            return [dr.ravel(mi.Vector4f(row.x, row.y, row.z, value)) for row, value in pairs]

        self._packets = packets(gaussians.irradiance)
        self._parts: dict[str, list[Any]] = {}
        if self.error is not None:
            errors = gaussians.irradiance * from_numpy(mi.Float, self.error)
            self._parts["error"] = packets(errors)
        if self.caustics is not None:
            caustics = gaussians.irradiance * from_numpy(mi.Color3f, self.caustics)
            self._parts["caustics"] = packets(caustics)
        self._vectors: list[Any] = []
        for k in range(0 if self.vectors is None else self.vectors.shape[1]):
            assert self.vectors is not None
            vector = from_numpy(mi.Vector4f, self.vectors[:, k])
            self._vectors.append(dr.ravel(dr.gather(mi.Vector4f, vector, order)))
        dr.eval(self._packets, self._parts, self._vectors)

    def set_vectors(self, vectors: np.ndarray) -> None:
        """Take vectors that are blended like the colours, (N, K, 4)."""
        self.vectors = vectors
        self._pack()

    def set_caustics(self, caustics: np.ndarray) -> None:
        """Take the part of the Gaussians' irradiance that is caustics, (N, 3)."""
        self.caustics = caustics
        self._pack()

    def set_error(self, error: np.ndarray) -> None:
        """Take the expected relative errors of the Gaussians, (N,)."""
        self.error = error
        self._pack()

    def unfold(self, x: mi.Point3f) -> mi.Point3f:
        """Where queries at points look for Gaussians, (N, 3): see :mod:`gpf.field.detail`."""
        return x if self.detail is None else self.detail.unfold(x)

    def _term(
        self, x: mi.Point3f, mean: mi.Point3f, index: mi.UInt32, support2: mi.Float, active: mi.Bool
    ) -> tuple[mi.Float, list[Any]]:
        """Weight of one neighbour, and its weighted values; zero at inactive lanes."""
        packets = [dr.gather(mi.Vector4f, p, index, active) for p in self._packets]
        rows = tuple(mi.Vector3f(p.x, p.y, p.z) for p in packets)
        weight = dr.select(active, blend_weight(x - mean, rows, support2), 0)  # type: ignore[arg-type]
        values: list[Any] = [weight * mi.Color3f(*(p.w for p in packets))]
        for packet in self._vectors:
            values.append(weight * dr.gather(mi.Vector4f, packet, index, active))
        return weight, values

    @dr.syntax
    def _add(self, state, x, n, index, record, inside):  # type: ignore[no-untyped-def]
        """Add a candidate to the neighbour count and the sums of weights and weighted values."""
        count, total, sums = state
        inside &= self.search.accepts(record, x, n)
        # Most candidates are too far away for all lanes of a packet, which then skips this.
        if inside:
            inside = self.search.reaches(index, x, inside)
            weight, weighted = self._term(x, record.p, index, dr.square(self.search.radius), inside)
            count += dr.select(inside, 1, 0)
            total += weight
            sums = add_all(sums, weighted)
        return count, total, sums

    def query(self, x: mi.Point3f, n: mi.Normal3f, active: mi.Bool) -> tuple[mi.Color3f, mi.Float]:
        """The stored quantity at surface points.

        Parameters
        ----------
        x, n: positions and viewer-side normals, (N, 3).

        Returns
        -------
        value: irradiance, W/m², or radiance (see the settings), (N, 3); 0 without neighbours.
        reach: distance of the farthest neighbour used, in search radii and at least 1, (N,):
            1 in dense regions, more where the k nearest lie farther away, infinite without
            neighbours.
        """
        values, reach = self.query_all(x, n, active)
        return values[0], reach

    @dr.syntax
    def query_all(
        self, x: mi.Point3f, n: mi.Normal3f, active: mi.Bool
    ) -> tuple[list[Any], mi.Float]:
        """As :meth:`query`, but with all values: colours, and vectors if there are any, (N, 4)."""
        settings = self.settings
        x = self.unfold(x)
        radius2 = self.search.radius * self.search.radius
        count = mi.UInt32(0)
        total = mi.Float(0)
        sums: list[Any] = [mi.Color3f(0), *zeros(len(self._vectors))]

        def add(state, index, record, distance2, inside):  # type: ignore[no-untyped-def]
            return self._add(state, x, n, index, record, inside)

        if dr.hint(settings.neighbours != "knn", mode="scalar"):
            count, total, sums = self.search.visit(x, n, add, (count, total, sums), active)
        reach = mi.Float(1)

        if dr.hint(settings.neighbours != "radius", mode="scalar"):
            sparse = active & (count <= settings.k)
            index, distance2 = self.search.nearest(x, n, sparse)
            farthest2, support2 = supplement_support(distance2)
            total = dr.select(sparse, 0, total)
            sums = keep_where(~sparse, sums)
            for j in range(settings.k):
                found = sparse & (distance2[j] < dr.inf)
                mean = self.search.hash.record(index[j], found).p
                weight, weighted = self._term(x, mean, index[j], support2, found)
                total += weight
                sums = add_all(sums, weighted)
            reach = dr.select(sparse, dr.maximum(dr.sqrt(farthest2 / radius2), reach), reach)

        known = active & (total > 0)
        if dr.hint(settings.blend == "divided", mode="scalar"):
            sums = divide_all(sums, total)
        return keep_where(known, sums), dr.select(known, reach, dr.inf)

    def part(self, name: str) -> GaussianPhotonField:
        """A field with the same Gaussians, whose quantity is the expected ``error`` of this one, or
        the part of it that is ``caustics``, in its unit.

        Raises
        ------
        RuntimeError: the field does not know its error, or which part that is.
        """
        if name not in self._parts:
            raise RuntimeError(f"This field does not know its {name}: fit it again with `gpf fit`.")
        other = copy.copy(self)
        other._packets, other._vectors = self._parts[name], []
        return other

    def reflect(self, points: VisiblePoints, value: mi.Color3f) -> mi.Color3f:
        """L at visible points, W/(m² sr), (N, 3), from the stored quantity there, (N, 3)."""
        # Other programs' files, or a network in the field's place, may give negative values.
        # Not by `maximum`: at 0, it would have no derivative.
        value = dr.select(value >= 0, value, 0)
        if self.settings.stores == "irradiance":
            return points.radiance(value)
        return points.emission + dr.select(points.valid, points.throughput * value, 0)

    def __repr__(self) -> str:
        count = dr.width(self.gaussians.means)
        return f"GaussianPhotonField[{count} Gaussians, {self.settings}]"
