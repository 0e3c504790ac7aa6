"""A hash table of cells on the device, with some sums for each."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy

LINE = 8
"""Usual number of 64-bit integers for a cell's sums; they fill one cache line."""

# The table grows before it is more than _FULL used, to _SPARE times the size needed.
_FULL, _SPARE = 0.7, 1.5


class CellTable:
    """Cells by key, which is never 0, in slots (open addressing).

    Parameters
    ----------
    line: number of sums for each cell.

    Attributes
    ----------
    capacity: number of slots.
    keys: the key in each slot, (capacity,); 0 if it is free.
    """

    def __init__(self, capacity: int, line: int = LINE) -> None:
        self._line = line
        self._lost = dr.zeros(mi.UInt32, 1)
        self._make_room(capacity)

    def _make_room(self, capacity: int) -> None:
        self.capacity = capacity
        self._last = dr.opaque(mi.UInt32, capacity - 1)
        self._cells = dr.zeros(mi.UInt32, 1)
        self.keys = dr.zeros(mi.UInt64, capacity)
        self._sums = dr.zeros(mi.UInt64, self._line * capacity)
        dr.eval(self.keys, self._sums)

    def reserve(self, cells: float) -> None:
        """Grow if so many more cells would fill the table."""
        wanted = (int(self._cells[0]) + cells) / _FULL
        if wanted > self.capacity:
            self._grow(math.ceil(_SPARE * wanted))
            dr.flush_malloc_cache()  # Dr.Jit would keep the old table for later

    def _grow(self, capacity: int) -> None:
        """Move all cells into a larger table."""
        keys, sums = self.keys, self._sums
        taken = dr.compress(keys != 0)
        self._make_room(capacity)
        if dr.width(taken) > 0:
            known = dr.gather(mi.UInt64, keys, taken)
            self._insert(known, lambda k: dr.gather(mi.UInt64, sums, self._line * taken + k))

    def _insert(self, keys: mi.UInt64, column: Callable[[int], mi.UInt64]) -> None:
        """Put cells into an empty table; ``column(k)``: their sums k, (C,)."""
        slot = self.find(keys, mi.Bool(True))
        dr.eval(slot, self.keys, self._cells, self._lost)
        for k in range(self._line):
            dr.scatter(self._sums, column(k), self._line * slot + k)
        dr.eval(self._sums)

    @dr.syntax
    def find(self, key: mi.UInt64, active: mi.Bool):  # type: ignore[no-untyped-def]
        """The slots of cells, (N,), new ones for those that have none."""
        low, high = mi.sample_tea_32(mi.UInt32(key), mi.UInt32(key >> 32), 4)
        slot = mi.UInt32((mi.UInt64(low ^ high) * mi.UInt64(self._last + 1)) >> 32)
        looking, probes = mi.Bool(active), mi.UInt32(0)
        while looking:
            there = dr.gather(mi.UInt64, self.keys, slot, looking)
            if there == 0:
                old, won = dr.scatter_cas(self.keys, mi.UInt64(0), key, slot, looking)
                dr.scatter_add(self._cells, mi.UInt32(1), 0, won)
                there = dr.select(won, key, old)
            looking &= there != key
            further = dr.select(slot == self._last, 0, slot + 1)
            slot = dr.select(looking, further, slot)
            probes += 1
            if probes > self._last:  # the table is full
                dr.scatter_add(self._lost, mi.UInt32(1), 0, looking)
                looking = mi.Bool(False)
        return slot

    def add(
        self,
        key: mi.UInt64,
        values: Sequence[tuple[mi.UInt32, mi.UInt64]],
        active: mi.Bool,
    ) -> None:
        """Add values to sums of cells, with their numbers from 0."""
        line = self._line * self.find(key, active)
        for column, value in values:
            dr.scatter_add(self._sums, value, line + column, active, dr.ReduceMode.Direct)

    def evaluate(self) -> None:
        """Carry out what was added.

        Raises
        ------
        RuntimeError: the table was full.
        """
        dr.eval(self._cells, self._lost, self.keys, self._sums)
        if int(self._lost[0]) > 0:
            raise RuntimeError(f"{self._lost[0]} photons did not fit into {self.capacity} cells")

    def sums(self, slot: mi.UInt32, column: int, active: mi.Bool | bool = True) -> mi.UInt64:
        """One of the sums of the cells in slots, (N,)."""
        return dr.gather(mi.UInt64, self._sums, self._line * slot + column, active)

    def tensors(self) -> dict[str, np.ndarray]:
        """The keys, (C,), and the sums, (C, line), for a file."""
        taken = dr.compress(self.keys != 0)
        if dr.width(taken) == 0:
            empty = np.zeros((0, self._line), np.uint64)
            return {"keys": empty[:, 0], "sums": empty}
        columns = [self.sums(taken, k).numpy() for k in range(self._line)]
        return {
            "keys": dr.gather(mi.UInt64, self.keys, taken).numpy(),
            "sums": np.stack(columns, 1),
        }

    def restore(self, tensors: Mapping[str, np.ndarray]) -> None:
        """Restore the cells from :meth:`tensors`; there must be none yet."""
        keys = from_numpy(mi.UInt64, tensors["keys"])
        self._make_room(max(self.capacity, math.ceil(_SPARE * dr.width(keys) / _FULL)))
        if dr.width(keys) > 0:
            self._insert(keys, lambda k: from_numpy(mi.UInt64, tensors["sums"][:, k]))
