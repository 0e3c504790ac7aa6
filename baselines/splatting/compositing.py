"""Compositing of footprints, front to back, and its adjoint."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from baselines.splatting.projection import FAINTEST, Footprints
from baselines.splatting.tiles import TILE, TileLists

# Upper limit of a footprint's α.
DENSEST = 0.999
# A pixel is done when its transmittance is below this.
OPAQUE = 1e-4
# Lanes of a tile; each has 2×2 pixels. Lanes and pixels are ordered by row, then column.
LANES = TILE * TILE // 4


class Compositor:
    """One image of footprints on a black background.

    The colour I of the pixel at x is a sum over the footprints i of its tile's list,

        α_i = min(o_i exp(-(x - c_i)ᵀ C_i (x - c_i) / 2), DENSEST), 0 below FAINTEST,
        I = Σ_i T_i α_i c_i,    T_i = Π_{j<i} (1 - α_j),

    until all four pixels of its lane are opaque.
    """

    def __init__(self, found: Footprints, lists: TileLists) -> None:
        self.lists = lists
        self.count = dr.width(found.opacities)
        self.packets = [
            dr.ravel(mi.Vector4f(found.centres.x, found.centres.y, found.opacities, 0)),
            dr.ravel(mi.Vector4f(*found.conics, 0)),
            dr.ravel(mi.Vector4f(*found.colours, 0)),
        ]
        across, down = lists.tiles
        lane = dr.arange(mi.UInt32, across * down * LANES)
        self._tile, place = lane // LANES, lane % LANES
        row = self._tile // dr.opaque(mi.UInt32, across)
        column = self._tile - row * dr.opaque(mi.UInt32, across)
        side = TILE // 2
        x = TILE * column + 2 * (place % side)
        y = TILE * row + 2 * (place // side)
        # One vector component per pixel of the lane.
        self._x, self._y = mi.Vector4u(x, x + 1, x, x + 1), mi.Vector4u(y, y, y + 1, y + 1)
        self._centre_x, self._centre_y = mi.Vector4f(self._x) + 0.5, mi.Vector4f(self._y) + 0.5
        width, height = (dr.opaque(mi.UInt32, n) for n in lists.size)
        self._inside = (self._x < width) & (self._y < height)
        self._at = self._y * width + self._x
        self._through = dr.select(self._inside, mi.Vector4f(1), 0)
        self._image = [mi.Vector4f(0)] * 3

    def image(self) -> mi.Float:
        """The image as a flat array (3 W H,), by row, column, channel."""
        *channels, _ = _blend(
            self.lists, self._tile, self._centre_x, self._centre_y, self.packets, self._through
        )
        self._image = channels
        width, height = self.lists.size
        result = dr.zeros(mi.Float, 3 * width * height)
        for k in range(3):
            for pixel in range(4):
                at, inside = 3 * self._at[pixel] + k, self._inside[pixel]
                dr.scatter(result, channels[k][pixel], at, inside, mode=dr.ReduceMode.Permute)
        dr.eval(result, self._image)
        return result

    def gradients(self, adjoint: mi.Float) -> Footprints:
        """Derivatives of a loss for the footprints, from its derivative for the last :meth:`image`.

        Those for depths and extents are 0.
        """
        of_image = [
            mi.Vector4f(
                *(
                    dr.gather(mi.Float, adjoint, 3 * self._at[p] + k, self._inside[p])
                    for p in range(4)
                )
            )
            for k in range(3)
        ]
        result = [dr.zeros(mi.Float, 4 * self.count) for _ in range(3)]
        rest = sum((a * b for a, b in zip(of_image, self._image, strict=True)), mi.Vector4f(0))
        _accumulate(
            self.lists,
            self._tile,
            self._centre_x,
            self._centre_y,
            self.packets,
            self._through,
            of_image,
            rest,
            result,
        )
        dr.eval(result)
        index = dr.arange(mi.UInt32, self.count)
        a, b, c = (dr.gather(mi.Vector4f, packet, index) for packet in result)
        return Footprints(
            centres=mi.Vector2f(a.x, a.y),
            conics=mi.Vector3f(b.x, b.y, b.z),
            opacities=a.z,
            colours=mi.Color3f(c.x, c.y, c.z),
            depths=mi.Float(0),
            extents=mi.Vector2f(0),
        )


class _Term:
    """A footprint in the four pixels of each lane."""

    def __init__(self, index, x, y, packets):  # type: ignore[no-untyped-def]
        place, conic, colour = (dr.gather(mi.Vector4f, packet, index) for packet in packets)
        self.dx, self.dy = x - place.x, y - place.y
        self.conic, self.colour = conic, colour
        power = (
            conic.x * dr.square(self.dx) + conic.z * dr.square(self.dy)
        ) * -0.5 - conic.y * self.dx * self.dy
        self.bell = dr.exp(power)
        raw = place.z * self.bell
        # An exponent that rounding makes positive does not count.
        self.counts = (raw >= FAINTEST) & (power <= 0)
        self.alpha = dr.select(self.counts, dr.minimum(raw, DENSEST), 0)
        self.moves = self.counts & (raw < DENSEST)


@dr.syntax
def _blend(
    lists: TileLists,
    tile: mi.UInt32,
    x: mi.Vector4f,
    y: mi.Vector4f,
    packets: list[mi.Float],
    through: mi.Vector4f,
) -> tuple[mi.Vector4f, mi.Vector4f, mi.Vector4f, mi.Vector4f]:
    """Red, green and blue of each lane's pixels, and their transmittance."""
    i = dr.gather(mi.UInt32, lists.starts, tile)
    end = dr.gather(mi.UInt32, lists.starts, tile + 1)
    through = mi.Vector4f(through)  # a copy, because updates are in place
    red, green, blue = mi.Vector4f(0), mi.Vector4f(0), mi.Vector4f(0)
    while (i < end) & (dr.max(through) > OPAQUE):
        term = _Term(dr.gather(mi.UInt32, lists.indices, i), x, y, packets)
        weight = through * term.alpha
        red += weight * term.colour.x
        green += weight * term.colour.y
        blue += weight * term.colour.z
        through *= 1 - term.alpha
        i += 1
    return red, green, blue, through


@dr.syntax
def _accumulate(
    lists: TileLists,
    tile: mi.UInt32,
    x: mi.Vector4f,
    y: mi.Vector4f,
    packets: list[mi.Float],
    through: mi.Vector4f,
    adjoint: list[mi.Vector4f],
    rest: mi.Vector4f,
    result: list[mi.Float],
) -> None:
    """Add the gradients of all footprints to ``result``, in the layout of ``packets``.

    With the derivative G for the pixel and the light behind footprint i, R_i = G · Σ_{j>i} T_j α_j
    c_j,

        ∂c_i = T_i α_i G,    ∂α_i = T_i G · c_i - R_i / (1 - α_i).

    ``rest`` starts as G · I; each footprint subtracts its part, front to back, so that the same
    footprints count as in :func:`_blend`.
    """
    i = dr.gather(mi.UInt32, lists.starts, tile)
    end = dr.gather(mi.UInt32, lists.starts, tile + 1)
    through, rest = mi.Vector4f(through), mi.Vector4f(rest)
    while (i < end) & (dr.max(through) > OPAQUE):
        index = dr.gather(mi.UInt32, lists.indices, i)
        term = _Term(index, x, y, packets)
        weight = through * term.alpha
        brings = (
            adjoint[0] * term.colour.x + adjoint[1] * term.colour.y + adjoint[2] * term.colour.z
        )
        rest -= weight * brings
        to_alpha = dr.select(term.moves, through * brings - rest / (1 - term.alpha), 0)
        to_power = term.alpha * to_alpha
        to_dx, to_dy = to_power * term.dx, to_power * term.dy
        centre_x, centre_y = dr.sum(to_dx), dr.sum(to_dy)
        rows = [
            mi.Vector4f(
                term.conic.x * centre_x + term.conic.y * centre_y,
                term.conic.y * centre_x + term.conic.z * centre_y,
                dr.sum(term.bell * to_alpha),
                0,
            ),
            mi.Vector4f(
                -0.5 * dr.sum(to_dx * term.dx),
                -dr.sum(to_dx * term.dy),
                -0.5 * dr.sum(to_dy * term.dy),
                0,
            ),
            mi.Vector4f(*(dr.sum(weight * a) for a in adjoint), 0),
        ]
        some = dr.any(term.counts)
        for k in range(3):
            for c in range(3):
                # All lanes of a packet add to the same place: they are summed, then written once.
                dr.scatter_add(result[k], rows[k][c], 4 * index + c, some, mode=dr.ReduceMode.Local)
        through *= 1 - term.alpha
        i += 1
