"""Light at supervised points from the photons of many passes, in two halves."""

from __future__ import annotations

from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.random import Stream, pass_seed
from gpf.core.structs import Photons, VisiblePoints, from_numpy, take, to_numpy
from gpf.photons.density import PhotonDensity
from gpf.photons.emission import Source
from gpf.photons.photon_cells import PhotonCells
from gpf.photons.photon_grid import PhotonSums, trace_pass
from gpf.scene.bounds import scene_bounds
from gpf.scene.light_groups import LightGroups
from gpf.sppm.edge_correction import covered_share, near_edges
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings, radius_at
from gpf.training.kernel_width import WIDTHS
from gpf.training.volume_light import VolumeLight

# Edge of the cells in which photons are added up, in units of the widest kernel's radius after
# TYPICAL_PASSES passes: where points are dense, half of the narrowest kernel's radius.
CELL, TYPICAL_PASSES = 0.5 * WIDTHS[-1], 100

# Rays per point near an edge, and per half, that measure how much of a kernel's disc lies on the
# surface.
EDGE_RAYS = 32

# Begins the names of the tensors of photons in media.
_VOLUME = "volume/"


class PhotonLight:
    """Irradiance of points from photons, which are added up in cells
    (:class:`gpf.photons.photon_grid.PhotonSums`): odd-numbered and even-numbered passes separately.

    Parameters
    ----------
    settings: settings of the passes, suited to the scene; ``alpha`` and ``initial_radius``
        determine the radius.
    groups: groups of emitters whose light is kept apart.
    volume: takes the photons in media.

    Attributes
    ----------
    passes: number of passes so far.
    coarse: which points lie in larger cells, where narrow kernels would show individual cubes, (N,)
        bool.
    """

    def __init__(
        self,
        points: FixedPoints,
        settings: PassSettings,
        seed: int,
        source: Source,
        groups: LightGroups | None,
        volume: VolumeLight | None = None,
    ) -> None:
        self.points, self.seed, self.passes = points, seed, 0
        self.volume = volume
        self.settings, self._bounds = settings, scene_bounds(points.scene)
        # The final radius is not known here, but the radius shrinks slowly.
        cell = CELL * radius_at(TYPICAL_PASSES, settings.initial_radius, settings.alpha)
        p, n = points.points.p, points.points.n
        cells = PhotonCells(cell, self._bounds, to_numpy(p))
        table = None if groups is None else groups.table(points.scene)
        self._sums = PhotonSums(cells, settings.path_settings(source), groups=table)
        self.coarse = np.asarray((cells.find(p)[0] > 0).numpy())
        self._edges = np.zeros(len(self.coarse), bool)
        if settings.edge_correction:
            edge_seed = pass_seed(seed, 0, Stream.EDGES)
            first_radius = settings.initial_radius  # later ones are smaller
            self._edges = near_edges(points.scene, p, n, first_radius, edge_seed).numpy()

    @property
    def radius(self) -> float:
        """Radius of the widest kernel, world units: that of the last pass."""
        return radius_at(max(self.passes, 1), self.settings.initial_radius, self.settings.alpha)

    def add_pass(self, diffused: bool) -> None:
        """Trace one more pass. ``diffused``: whether to include photons from diffuse surfaces."""
        number = self.passes + 1
        seed = pass_seed(self.seed, number, Stream.PHOTONS)
        cloud = None if self.volume is None else self.volume.sums
        trace_pass(self.points.scene, seed, number % 2, self._sums, cloud, diffused)
        dr.sync_thread()
        self.passes = number

    def gather(self, half: int, asked: np.ndarray, diffused: bool) -> list[np.ndarray]:
        """Irradiance of the points that are ``asked`` for, (N,) bool, from the photons of a half,
        with each kernel of :data:`WIDTHS`, (N, 3) each; zero at the others.

        ``diffused``: whether photons from diffuse surfaces count.
        """
        photons, found = self._sums.photons(half, diffused=diffused), []
        for width in WIDTHS:
            radius = width * self.radius
            light = self._gather(photons, radius, asked)
            lit = asked & light.any(axis=1)
            found.append(light * self._correct_edges(radius, 2 * self.passes + half, lit))
        del photons
        dr.flush_malloc_cache()  # hundreds of megabytes, which the other half needs, too
        return found

    def uncorrected(self, half: int, asked: np.ndarray, diffused: bool) -> np.ndarray:
        """As :meth:`gather`, with the widest kernel only, and too dark near edges."""
        return self._gather(self._sums.photons(half, diffused=diffused), self.radius, asked)

    def by_group(self, groups: LightGroups, asked: np.ndarray, kernel: np.ndarray) -> np.ndarray:
        """Irradiance of the points that are asked for from each group of emitters, from all passes,
        (G, N, 3).

        ``kernel``: the kernel of each point, (N,): indices into :data:`WIDTHS`.
        """
        found = np.zeros((len(groups.names), len(asked), 3), np.float32)
        shares = self.passes // 2 / self.passes, (self.passes + 1) // 2 / self.passes
        for number, width in enumerate(WIDTHS):
            radius, chosen = width * self.radius, asked & (kernel == number)
            correction = self._correct_edges(radius, 2 * self.passes, chosen)
            for group in range(len(found)):
                for half, share in enumerate(shares):
                    light = self._gather(self._sums.photons(half, group), radius, chosen)
                    found[group] += np.float32(share) * light * correction
        return found

    def _gather(self, photons: Photons, radius: float, chosen: np.ndarray) -> np.ndarray:
        """Irradiance of the chosen points, without edge correction, (N, 3); zero at the others."""
        density = PhotonDensity(photons, radius, self._bounds, smooth=True)
        found = np.zeros((len(chosen), 3), np.float32)
        if chosen.any():
            part = self._part(chosen)
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
        correction = np.ones((len(lit), 1), np.float32)
        seed = pass_seed(self.seed, number, Stream.EDGES)
        near = self._edges & lit
        if near.any():
            part = self._part(near)
            share = covered_share(self.points.scene, part.p, part.n, radius, seed, EDGE_RAYS)
            correction[near, 0] = 1 / share.numpy()
        return correction

    def _part(self, chosen: np.ndarray) -> VisiblePoints:
        return take(self.points.points, from_numpy(mi.UInt32, np.flatnonzero(chosen)))

    def tensors(self) -> dict[str, np.ndarray]:
        """The photons so far, for a file."""
        found = self._sums.tensors()
        if self.volume is not None:
            found |= {_VOLUME + name: v for name, v in self.volume.sums.tensors().items()}
        return found

    def restore(self, tensors: Mapping[str, np.ndarray], passes: int) -> None:
        """Continue from :meth:`tensors` after this many passes."""
        self._sums.restore(tensors)
        if self.volume is not None:
            inside = {n: v for n, v in tensors.items() if n.startswith(_VOLUME)}
            self.volume.sums.restore({n.removeprefix(_VOLUME): v for n, v in inside.items()})
        self.passes = passes
