"""A volume that emits and absorbs, given by networks: density, and colour by direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from baselines.neural.hash_encoding import GridShape, HashGrid, Network

# Order of the spherical harmonics that encode a direction; there are 16.
DIRECTION_ORDER = 3

# Exponents are clamped to this: larger values are not needed and could overflow.
LARGEST_EXPONENT = 12.0


@dataclass(frozen=True)
class VolumeShape:
    """Sizes of the networks.

    Attributes
    ----------
    grid: encoding of the position.
    density_hidden: widths of the hidden layers of the density network.
    features: outputs of the density network that are inputs of the colour network.
    colour_hidden: widths of the hidden layers of the colour network.
    """

    grid: GridShape
    density_hidden: tuple[int, ...] = (32,)
    features: int = 15
    colour_hidden: tuple[int, ...] = (32,)


class RadianceVolume:
    """σ(x) = exp f_0(γ(x)),    c(x, d) = u exp g(f_1..(γ(x)), Y(d)).

    γ is a hash grid, f and g are networks, Y are spherical harmonics. Colour is linear without an
    upper bound, as in RawNeRF, because HDR images contain bright lamps.

    Parameters
    ----------
    unit: u, W/(m² sr).
    """

    def __init__(self, shape: VolumeShape, unit: float, seed: int) -> None:
        directions = (DIRECTION_ORDER + 1) ** 2
        self.unit = unit
        self.grid = HashGrid(shape.grid, seed)
        self.density_network = Network(
            shape.grid.outputs, shape.density_hidden, 1 + shape.features, seed + 1
        )
        self.colour_network = Network(shape.features + directions, shape.colour_hidden, 3, seed + 2)

    @property
    def parameters(self) -> list[mi.Float]:
        """The grid's features, and the weights of both networks."""
        parts = self.grid, self.density_network, self.colour_network
        return [part.parameters for part in parts]

    def update(self, parameters: list[mi.Float]) -> None:
        """Replace the parameters."""
        parts: tuple[Any, ...] = self.grid, self.density_network, self.colour_network
        for part, values in zip(parts, parameters, strict=True):
            part.update(values)

    def density(self, place: mi.Point3f) -> mi.Float:
        """σ at places in the unit cube, per edge of the cube, (N,)."""
        return _exp(self.density_network(self.grid(place))[0])

    def __call__(self, place: mi.Point3f, d: mi.Vector3f) -> tuple[mi.Float, mi.Color3f]:
        """σ at places, (N,), and c / u for rays of direction ``d``, (N, 3)."""
        answer = self.density_network(self.grid(place))
        colour = self.colour_network([*answer[1:], *dr.sh_eval(d, DIRECTION_ORDER)])
        return _exp(answer[0]), mi.Color3f(*(_exp(value) for value in colour))


def _exp(value: mi.Float) -> mi.Float:
    return dr.exp(dr.minimum(value, LARGEST_EXPONENT))
