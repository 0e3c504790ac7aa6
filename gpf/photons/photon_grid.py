"""The photons of any number of passes in bounded memory: summed in small cells during tracing.

A density estimate does not need single photons: the photons in a cell that is smaller than the
kernel, or than the distance between the points that gather them, count as one photon at their mean
position, with the sum of their powers. A pass costs little more than its photon walk, for any
number of points, and the kernel's radius can be chosen after tracing. Two halves of the passes are
kept apart, so that their results can be compared; they share the cells and the mean positions in
them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import Photons, from_numpy, to_numpy
from gpf.photons.cell_table import LINE, CellTable
from gpf.photons.emission import Emitted
from gpf.photons.photon_cells import LEVEL_BITS, PhotonCells
from gpf.photons.tracing import PathSettings, record_all, trace_photons
from gpf.scene.bounds import inside_box
from gpf.scene.light_groups import group_of

# Coordinates of normals are rounded to thirds: this changes a direction by at most 17°.
_NORMAL_STEPS = 3

# Bit positions of the level and the group in a cell's key.
_LEVEL_SHIFT = 57
_GROUP_SHIFT = _LEVEL_SHIFT + LEVEL_BITS
_GROUP_BITS = 4
_DIFFUSED = 1 << 63

# Positions in a cell are in 1024ths of its edge: sums of four million photons fit into 32 bits.
_PLACES = 1024

# A typical photon's power is this number of steps.
_POWER_STEPS = 2.0**24

# Paths that measure the typical power of a photon and the number of photons per path.
PILOT = 1024

# Columns of a cell's sums: three of power for each half; x and y as two sums of 32 bits in one
# number of 64 bits; z and the number of photons in another.
_POWER, _XY, _ZN = (0, 5), 3, 4

# Two more for the mean direction in media, in the same way as the mean position.
_DIRECTION_XY, _DIRECTION_Z = LINE, LINE + 1


class PhotonSums:
    """Sums of photons by cell: by cube of space, rounded direction of the normal, and group of
    lights.

    The sums are integers, so that the order of the photons does not change them.

    Parameters
    ----------
    cells: the cubes.
    settings: the photon paths of each pass.
    capacity: initial number of slots in the table.
    groups: table that keeps the light of groups of emitters apart; see :meth:`LightGroups.table`.
    floating: whether these are photons in media. Cells keep the mean direction of their photons;
        there is one for each octant of directions. Photons beyond the cubes are left out.

    Attributes
    ----------
    table: the cells.
    paths: number of photon paths in each half so far.
    """

    def __init__(
        self,
        cells: PhotonCells,
        settings: PathSettings,
        capacity: int = 1 << 20,
        groups: mi.UInt32 | None = None,
        floating: bool = False,
    ) -> None:
        self._cubes = cells
        self._unit, self._landings = 0.0, 0.0
        self._settings, self._groups = settings, groups
        self._group, self._column, self._every = mi.UInt32(0), mi.UInt32(0), mi.Bool(True)
        self.paths = [0, 0]
        self._floating = floating
        self.table = CellTable(capacity, LINE + 2 if floating else LINE)

    def _learn(self, few: Photons) -> None:
        """Note the typical power and the number of photons, from :data:`PILOT` paths."""
        sizes = np.abs(to_numpy(few.power)).max(axis=1) if dr.width(few.p) else np.ones(1)
        self._unit = float(sizes.mean() or 1) * PILOT / _POWER_STEPS
        self._landings = (dr.width(few.p) + 1) / PILOT

    def _prepare(self, half: int, diffused: bool) -> None:
        paths = self._settings.paths
        # Each photon may need a new cell.
        self.table.reserve(1.5 * self._landings * paths)
        # Photons have the power of one of `paths` paths; the sums are for a single path.
        self._scale = dr.opaque(mi.Float, paths / self._unit)
        self._column = dr.opaque(mi.UInt32, _POWER[half])
        self._every = dr.opaque(mi.Bool, diffused)

    def _add(self, photons: Photons, diffused: mi.Bool, active: mi.Bool) -> None:
        active = active & (self._every | ~diffused)
        if self._floating:
            active &= inside_box(photons.p, self._cubes.bounds)
        level, corner, place = self._cubes.find(photons.p)
        n = dr.sign(photons.n) if self._floating else _thirds(photons.n)
        key = _pack(corner, mi.Vector3u(n + _NORMAL_STEPS))
        key |= mi.UInt64(level) << _LEVEL_SHIFT
        if self._groups is not None:
            key |= mi.UInt64(self._group) << _GROUP_SHIFT
        key |= dr.select(diffused, mi.UInt64(_DIFFUSED), mi.UInt64(0))
        inside = mi.Vector3u(dr.clip(place * _PLACES, 0, _PLACES - 1))
        power = photons.power * self._scale
        # In two's complement: some skies have negative colours.
        sums = [(self._column + k, mi.UInt64(mi.Int64(power[k]))) for k in range(3)]
        sums.append((mi.UInt32(_XY), mi.UInt64(inside.x) | (mi.UInt64(inside.y) << 32)))
        sums.append((mi.UInt32(_ZN), mi.UInt64(inside.z) | (mi.UInt64(1) << 32)))
        if self._floating:
            n = mi.Vector3u((photons.n + 1) * (0.5 * (_PLACES - 1)))
            sums.append((mi.UInt32(_DIRECTION_XY), mi.UInt64(n.x) | (mi.UInt64(n.y) << 32)))
            sums.append((mi.UInt32(_DIRECTION_Z), mi.UInt64(n.z)))
        self.table.add(key, sums, active)

    def photons(self, half: int, group: int | None = None, diffused: bool = True) -> Photons:
        """One photon for each cell that has light in this half, sorted by cell; powers are divided
        by the half's number of paths so far.

        In media, the direction is the mean of the photons, shorter than 1.

        ``group``: only the photons of this group of emitters; all by default. ``diffused``: whether
        to include those from diffuse surfaces; in media, those that have been scattered.
        """
        keys = self.table.keys
        wanted = keys != 0
        if group is not None:
            wanted &= ((keys >> _GROUP_SHIFT) & ((1 << _GROUP_BITS) - 1)) == group
        if not diffused:
            wanted &= (keys & _DIFFUSED) == 0
        every, power = dr.arange(mi.UInt32, self.table.capacity), mi.UInt64(0)
        for k in range(3):
            power |= self.table.sums(every, _POWER[half] + k, wanted)
        taken = dr.compress(wanted & (power != 0))
        if dr.width(taken) == 0:
            return dr.zeros(Photons, 0)
        found = np.asarray(dr.gather(mi.UInt64, keys, taken).numpy())
        slot = dr.gather(mi.UInt32, taken, from_numpy(mi.UInt32, np.argsort(found)))
        key = dr.gather(mi.UInt64, keys, slot)
        columns = (*(_POWER[half] + k for k in range(3)), _XY, _ZN)
        red, green, blue, xy, zn = (self.table.sums(slot, k) for k in columns)
        corner = mi.Vector3u(*(mi.UInt32((key >> (16 * k)) & 0xFFFF) for k in range(3)))
        level = mi.UInt32(key >> _LEVEL_SHIFT) & ((1 << LEVEL_BITS) - 1)
        places = mi.Vector3f(*(mi.Float(mi.UInt32(v)) for v in (xy, xy >> 32, zn)))
        count = mi.Float(mi.UInt32(zn >> 32))
        inside = (places / count + 0.5) / _PLACES
        n = mi.Vector3f(*(mi.Float((key >> (48 + 3 * k)) & 7) for k in range(3))) - _NORMAL_STEPS
        n = dr.normalize(n)
        if self._floating:
            xy, z = (self.table.sums(slot, k) for k in (_DIRECTION_XY, _DIRECTION_Z))
            total = mi.Vector3f(*(mi.Float(mi.UInt32(v)) for v in (xy, xy >> 32, z)))
            n = 2 * (total / count + 0.5) / (_PLACES - 1) - 1
        scale = dr.opaque(mi.Float, self._unit / max(self.paths[half], 1))
        photons = Photons(
            p=self._cubes.points(level, corner, inside),
            n=mi.Normal3f(n),
            power=mi.Color3f(*(mi.Float(mi.Int64(v)) for v in (red, green, blue))) * scale,
            depth=dr.full(mi.UInt32, int(self._settings.indirect), len(found)),
        )
        dr.eval(photons)
        return photons

    def tensors(self) -> dict[str, np.ndarray]:
        """The sums, for a file."""
        units = np.array([self._unit, self._landings, *self.paths])
        return self.table.tensors() | {"units": units}

    def restore(self, tensors: Mapping[str, np.ndarray]) -> None:
        """Restore the sums from :meth:`tensors`; there must be none yet."""
        self._unit, self._landings = (float(v) for v in tensors["units"][:2])
        self.paths = [int(n) for n in tensors["units"][2:]]
        self.table.restore(tensors)


def trace_pass(
    scene: mi.Scene,
    seed: int,
    half: int,
    surfaces: PhotonSums | None,
    cloud: PhotonSums | None = None,
    diffused: bool = True,
) -> None:
    """Add the photons of one more pass to half 0 or 1 of those on surfaces and of those in media.

    ``diffused``: whether to include those from diffuse surfaces on surfaces; once left out, they
    are missing for good.
    """
    both = surfaces, cloud
    there = [sums for sums in both if sums is not None]
    settings = there[0]._settings
    if not all(sums._unit for sums in there):
        few = record_all(scene, replace(settings, paths=PILOT, indirect=False), seed)
        for sums, photons in zip(both, few, strict=True):
            if sums is not None and not sums._unit:
                sums._learn(photons)
    for sums in there:
        sums._prepare(half, diffused or sums is cloud)
    deposit, float_by = (_ignore if sums is None else sums._add for sums in both)
    emitting = replace(settings, source=partial(_emit, there))
    trace_photons(scene, deposit, emitting, seed, None if cloud is None else float_by)
    for sums in there:
        sums.table.evaluate()
        sums.paths[half] += settings.paths


def _ignore(photons: Photons, diffused: mi.Bool, active: mi.Bool) -> None:
    """Take no photons."""


def _emit(every: Sequence[PhotonSums], scene: mi.Scene, sampler: mi.Sampler) -> Emitted:
    """The first rays; notes the group of each path."""
    ray, power, emitter = every[0]._settings.source(scene, sampler)
    for sums in every:
        if sums._groups is not None:
            sums._group = group_of(sums._groups, emitter)
    return ray, power, emitter


def rounded_normal(n: mi.Normal3f) -> mi.Normal3f:
    """A photon's normal as rounded by its cell, (N, 3)."""
    return dr.normalize(_thirds(n))


def _thirds(n: mi.Normal3f) -> mi.Normal3f:
    return dr.round(n * _NORMAL_STEPS)


def _pack(corner: mi.Vector3u, thirds: mi.Vector3u) -> mi.UInt64:
    """The key of a cell: 16 bits per coordinate of its corner, 3 per coordinate of its normal.

    It is never 0, because no unit normal is -3, -3, -3 thirds.
    """
    key = mi.UInt64(0)
    for k in range(3):
        key |= (mi.UInt64(corner[k]) << (16 * k)) | (mi.UInt64(thirds[k]) << (48 + 3 * k))
    return key
