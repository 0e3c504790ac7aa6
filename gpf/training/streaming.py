"""Streaming supervision: targets from the photons of any number of passes.

Training does not need converged targets: the noise of many points averages out over a Gaussian. The
photons of all passes are kept, so that a field can be fitted after some passes, and again after
more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated

import drjit as dr
import mitsuba as mi
import numpy as np
from pydantic import Field

from gpf.core.errors import uninterrupted
from gpf.core.random import Stream, pass_seed
from gpf.core.settings import Count, Positive, Seed, Settings
from gpf.core.structs import Photons, VisiblePoints, concatenate, from_numpy, take, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.photons.emission import Source, emit_light
from gpf.photons.photon_cells import PhotonCells
from gpf.photons.photon_grid import PhotonSums
from gpf.scene.bounds import scene_bounds
from gpf.scene.lamps import Lamps
from gpf.scene.light_groups import LightGroups
from gpf.sppm.density import PhotonDensity, radius_at
from gpf.sppm.edge_correction import covered_share, near_edges
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings, suit_scene
from gpf.training.direct_light import DirectLight
from gpf.training.gathered_light import GatheredLight
from gpf.training.kernel_width import WIDTHS, choose_kernels, kernel_blur, pick
from gpf.training.sampled_light import balance, some_runs
from gpf.training.targets import Targets, source_numbers

# Edge of the cells in which photons are added up, in units of the widest kernel's radius after
# TYPICAL_PASSES passes: where points are dense, half of the narrowest kernel's radius.
CELL, TYPICAL_PASSES = 0.5 * WIDTHS[-1], 100

# Numbers of passes after which the noise of the photons is compared with that of samples. The first
# is in time for the first field of a fit: light gathered from a field with noisy direct light stays
# too bright.
BALANCED = 6, 12, 48, 192

# Rays per point near an edge, and per half, that measure how much of a kernel's disc lies on the
# surface.
EDGE_RAYS = 32

# Samples of each group of emitters at each point for PhotonStream.by_group.
GROUP_SAMPLES = 16


class StreamSettings(Settings):
    """Settings of the stream: its passes, and the supervised points.

    Attributes
    ----------
    passes: photon passes in all.
    alpha: radius reduction, in (0, 1).
    radius: radius of the first pass, in units of the references' first radius.
    view_points, surface_points: largest numbers of supervised points that training views see, and
        of supervised samples of surfaces.
    """

    passes: Count = 300
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.75
    radius: Positive = 1.3
    view_points: Count = 200_000
    surface_points: Count = 300_000
    seed: Seed = 6

    def passes_like(self, passes: PassSettings) -> PassSettings:
        """The settings of the stream's passes, given those of the references' passes."""
        radius = self.radius * passes.initial_radius
        return passes.model_copy(update={"alpha": self.alpha, "initial_radius": radius})


class PhotonStream:
    """Photons of a growing number of passes, and the targets that they give at fixed points.

    Photons are added up in cells (:class:`gpf.photons.photon_grid.PhotonSums`), so the cost of a
    pass does not depend on the number of points. For targets, all photons of n passes are gathered
    with the radius of pass n of SPPM or, where light is sharp, with half or a quarter of it
    (:mod:`gpf.training.kernel_width`). Odd-numbered and even-numbered passes are added up
    separately: these two halves are independent.

    Parameters
    ----------
    settings: settings of the passes; ``alpha`` and ``initial_radius`` determine the radius.
    points: sets of points by name: each training view in order, then
        :data:`gpf.training.targets.SURFACES`; any of them may be missing.
    lamps: the emitters whose direct light the targets contain; by default all.
    groups: groups of emitters whose light is kept apart, for :meth:`by_group`.

    Attributes
    ----------
    gathered: the light of diffuse surfaces if it is gathered (:meth:`light_by`), or None.
    blur: squared error that the width of the kernels adds to the targets of the last call of
        :meth:`halves` (:func:`gpf.training.kernel_width.kernel_blur`), (N,).
    """

    def __init__(
        self,
        scene: mi.Scene,
        settings: PassSettings,
        points: Mapping[str, VisiblePoints],
        seed: int,
        source: Source = emit_light,
        lamps: Lamps | None = None,
        groups: LightGroups | None = None,
    ) -> None:
        self.scene, self.seed, self.count = scene, seed, 0
        self._groups = groups
        self.settings = suit_scene(settings, scene)
        # The lamps whose direct light is sampled and added to that of the photons. If photons bring
        # all direct light, what the targets should not contain is sampled and subtracted.
        sampled, sign = Lamps(scene) if lamps is None else lamps, 1
        if self.settings.direct == "photons":
            sampled, sign = sampled.others(), -1
        self._bounds = scene_bounds(scene)
        # The final radius is not known here, but the radius shrinks slowly.
        cell = CELL * radius_at(TYPICAL_PASSES, self.settings.initial_radius, self.settings.alpha)
        paths = self.settings.path_settings(source)
        table = None if groups is None else groups.table(scene)
        valid = [take(each, dr.compress(each.valid)) for each in points.values()]
        self._source = np.repeat(source_numbers(points), [dr.width(each.p) for each in valid])
        self._points = FixedPoints(scene, concatenate(valid))
        cells = PhotonCells(cell, self._bounds, to_numpy(self._points.points.p))
        # Narrow kernels would show individual cubes there.
        self._coarse = np.asarray((cells.find(self._points.points.p)[0] > 0).numpy())
        self._sums = PhotonSums(cells, paths, groups=table)
        self._direct = DirectLight(self._points, sampled, sign, seed)
        self.gathered: GatheredLight | None = None
        self._lit = 0
        self._rows: slice | np.ndarray = slice(None)
        self._kernel = np.zeros(len(self._source), np.uint8)
        self._edges = np.zeros(len(self._source), bool)
        if self.settings.edge_correction:
            p, n = self._points.points.p, self._points.points.n
            edge_seed = pass_seed(seed, 0, Stream.EDGES)
            first_radius = self.settings.initial_radius  # later ones are smaller
            self._edges = near_edges(scene, p, n, first_radius, edge_seed).numpy()
        self.blur = np.zeros(len(self._source), np.float32)

    @property
    def narrowest(self) -> float:
        """Radius of the narrowest kernel, world units."""
        return WIDTHS[-1] * self.radius

    @property
    def radius(self) -> float:
        """Radius of the widest kernel with which photons are gathered, world units."""
        return radius_at(max(self.count, 1), self.settings.initial_radius, self.settings.alpha)

    def advance(self, count: int, tick: Callable[[int], None] = lambda done: None) -> None:
        """Add passes until there are ``count``; ``tick(done)`` is called after each."""
        while self.count < count:
            with uninterrupted():
                number = self.count + 1
                seed = pass_seed(self.seed, number, Stream.PHOTONS)
                # Groups of lights still need to know whose light the diffuse surfaces send.
                every = self.gathered is None or self._groups is not None
                self._sums.trace(self.scene, seed, number % 2, every)
                dr.sync_thread()
                self.count = number
            if number in BALANCED and (self._direct.lamps or self.gathered):
                self._balance()
            if self._direct.per_pass > 0 or self.gathered:
                self.sample()
            tick(self.count)

    def light_by(self, field: GaussianPhotonField, seconds: float = math.inf) -> None:
        """From now on, gather the light of diffuse surfaces by rays that end in a field of the same
        scene; photons that bring this light no longer count.

        Nothing changes if the first rays would take longer than ``seconds``.
        """
        gathered = self._gathered_by(field, self.count)
        for _ in range(2):  # the first one compiles
            gathered.add()
        if (gathered.LEAST - gathered.samples) * gathered.seconds > seconds:
            return
        self._lit, self.gathered = self.count, gathered
        self._balance()
        self.sample()

    @property
    def sample_seconds(self) -> float:
        """Wall-clock time of the samples that go with a pass."""
        kinds = self._direct, self.gathered
        return sum(kind.per_pass * kind.seconds for kind in kinds if kind)

    def _gathered_by(self, field: GaussianPhotonField, lit: int) -> GatheredLight:
        seed = pass_seed(self.seed, lit, Stream.GATHER_RAYS)
        return GatheredLight(self._points, field, seed)

    def sample(self) -> None:
        """Add the samples that go with the passes so far."""
        self._direct.sample(self.count)
        if self.gathered:
            self.gathered.sample(self.count - self._lit)

    def _balance(self) -> None:
        """Choose how many samples to take per pass."""
        self.sample()
        rows = self._rows = some_runs(len(self._source))
        photons = [
            self._irradiance(self._photons(half), self.radius, self._asked())[rows]
            for half in range(2)
        ]
        dr.flush_malloc_cache()
        sampled = [self._direct] if self._direct.lamps else []
        kinds = [*sampled, self.gathered] if self.gathered else sampled
        means = [(kind.mean(0)[rows], kind.mean(1)[rows]) for kind in kinds]
        balance(self.count, (photons[0], photons[1]), kinds, means)

    def tensors(self) -> dict[str, np.ndarray]:
        """The photons and samples so far, for a file."""
        found = {"count": np.array([self.count])}
        found |= {f"photons/{name}": values for name, values in self._sums.tensors().items()}
        found |= {f"direct/{name}": values for name, values in self._direct.tensors().items()}
        if self.gathered:
            own = self.gathered.tensors() | {"lit": np.array([self._lit])}
            found |= {f"gathered/{name}": values for name, values in own.items()}
        return found

    def restore(
        self, tensors: Mapping[str, np.ndarray], field: GaussianPhotonField | None = None
    ) -> None:
        """Continue from :meth:`tensors` of a stream with the same arguments; ``field`` is the one
        given to its :meth:`light_by`, if any."""

        def part(start: str) -> dict[str, np.ndarray]:
            return {k.removeprefix(start): v for k, v in tensors.items() if k.startswith(start)}

        self.count = int(tensors["count"][0])
        self._sums.restore(part("photons/"))
        self._direct.restore(part("direct/"))
        if field is not None and (gathered := part("gathered/")):
            self._lit = int(gathered["lit"][0])
            self.gathered = self._gathered_by(field, self._lit)
            self.gathered.restore(gathered)

    def mean(self, halves: tuple[Targets, Targets]) -> Targets:
        """The points, with the irradiance from all passes so far, given their :meth:`halves`."""
        even, odd = halves
        share = self.count // 2 / self.count
        return replace(
            even,
            irradiance=share * even.irradiance + (1 - share) * odd.irradiance,
            direct=share * even.direct + (1 - share) * odd.direct,
        )

    def halves(self, stride: int = 1) -> tuple[Targets, Targets]:
        """The points, with the irradiance from passes with even and with odd numbers.

        With a ``stride`` above 1, only every ``stride``-th point; these, too, are spread evenly.
        """
        self._rows = slice(None, None, stride)
        points = self._points.points
        self.sample()
        position, normal = (to_numpy(v)[self._rows] for v in (points.p, points.n))
        coarse = self._coarse[self._rows]
        gathered = list(zip(*(self._gather(half) for half in range(2)), strict=True))
        kernel = np.where(coarse, 0, choose_kernels(position, normal, gathered, self.radius))
        self._kernel[self._rows] = kernel
        self.blur = np.where(coarse, 0, kernel_blur(kernel, gathered))
        light, found = pick(kernel, gathered), []
        for half in range(2):
            direct = self._direct.mean(half)[self._rows]
            diffuse = self.gathered.mean(half)[self._rows] if self.gathered else np.float32(0)
            found.append(
                Targets(
                    position=position,
                    normal=normal,
                    irradiance=light[half] + diffuse + direct,
                    direct=direct,
                    reflectance=to_numpy(points.reflectance)[self._rows],
                    source=self._source[self._rows],
                )
            )
        return found[0], found[1]

    def by_group(self) -> np.ndarray:
        """Irradiance of the points of the last call of :meth:`halves` from each group of emitters,
        from all passes, (G, N, 3), with the radius chosen there for all light."""
        assert self._groups is not None
        found = np.zeros((len(self._groups.names), len(self._source), 3), np.float32)
        shares = self.count // 2 / self.count, (self.count + 1) // 2 / self.count
        asked = self._asked()
        for number, width in enumerate(WIDTHS):
            radius, chosen = width * self.radius, asked & (self._kernel == number)
            correction = self._correct_edges(radius, 2 * self.count, chosen)
            for group in range(len(found)):
                for half, share in enumerate(shares):
                    photons = self._sums.photons(half, group)
                    gathered = self._irradiance(photons, radius, chosen)
                    found[group] += np.float32(share) * gathered * correction
        if self._direct.lamps:
            found += self._direct_by_group()
        return found[:, self._rows]

    def _direct_by_group(self) -> np.ndarray:
        """Sampled irradiance of the points from each group of emitters, (G, N, 3)."""
        assert self._groups is not None
        found, sampled = [], self._direct.lamps.indices
        for number, members in enumerate(self._groups.members):
            kept = members
            if sampled is not None:
                kept = tuple(k for k in members if k in sampled)
            seed = pass_seed(self.seed, number, Stream.GROUP_EMITTERS)
            lamps = Lamps(self.scene, kept)
            found.append(self._direct.sign * self._points.mean_direct(lamps, GROUP_SAMPLES, seed))
        return np.stack(found)

    def _gather(self, half: int) -> list[np.ndarray]:
        """Irradiance of the requested points from the photons of a half, with each kernel,
        (N, 3) each."""
        photons, found = self._photons(half), []
        for width in WIDTHS:
            radius = width * self.radius
            gathered = self._irradiance(photons, radius, self._asked())
            lit = self._asked() & gathered.any(axis=1)
            gathered *= self._correct_edges(radius, 2 * self.count + half, lit)
            found.append(gathered[self._rows])
        del photons
        dr.flush_malloc_cache()  # hundreds of megabytes, which the other half needs, too
        return found

    def _photons(self, half: int) -> Photons:
        """The photons of a half whose light is not gathered instead."""
        return self._sums.photons(half, diffused=self.gathered is None)

    def _irradiance(self, photons: Photons, radius: float, chosen: np.ndarray) -> np.ndarray:
        """Irradiance of the chosen points, (N,) bool, from photons, without edge correction,
        (N, 3); zero at the others."""
        density = PhotonDensity(photons, radius, self._bounds, smooth=True)
        found = np.zeros((len(chosen), 3), np.float32)
        if chosen.any():
            part = take(self._points.points, from_numpy(mi.UInt32, np.flatnonzero(chosen)))
            found[chosen] = to_numpy(density.irradiance(part.p, part.n))
        return found

    def _correct_edges(self, radius: float, number: int, lit: np.ndarray) -> np.ndarray:
        """Factors for the density of photons at each point, (N, 1) float32.

        Parameters
        ----------
        number: selects the random numbers: each half has its own, since what the halves have in
            common passes for light.
        lit: the points to correct, (N,) bool; the factor is 1 at the others.
        """
        correction = np.ones((len(self._source), 1), np.float32)
        seed = pass_seed(self.seed, number, Stream.EDGES)
        near = self._edges & lit
        if near.any():
            part = take(self._points.points, from_numpy(mi.UInt32, np.flatnonzero(near)))
            share = covered_share(self.scene, part.p, part.n, radius, seed, EDGE_RAYS)
            correction[near, 0] = 1 / share.numpy()
        return correction

    def _asked(self) -> np.ndarray:
        """Which of all points the last call of :meth:`halves` asked for, (N,) bool."""
        asked = np.zeros(len(self._source), bool)
        asked[self._rows] = True
        return asked
