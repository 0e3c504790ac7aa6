"""Scene files of RenderFormer in HDF5, and the normalisation of scenes.

Data sets, all float32 (the authors' textures are float16, which small bright lamps would overflow):

=========  ===============  ======================================================================
triangles  (N, 3, 3)        corners
vn         (N, 3, 3)        unit normals at the corners
texture    (N, 13, 32, 32)  diffuse (3), specular (3), roughness (1), a flat normal map (3),
                            emission (3); texel (i, j) is used where i + j <= 32
c2w        (V, 4, 4)        camera to world; x to the right, y up, -z ahead
fov        (V,)             degrees, of the whole square image
=========  ===============  ======================================================================

The network was trained on scenes between -½ and ½, seen from a distance of 1.5 to 2, with facets
like those of the authors' walls (128 per unit square), lit by up to eight white triangles. So a
scene is scaled to this box and its large facets are halved. Lamps of one colour share a file, in
which they are white: light is additive, so the view is the sum over the files of colour times the
network's image. The strength is chosen so that the mean irradiance of the lamps, without shadows,
is that of the authors' examples; the image is divided by it.

A limit of the format: lamps emit on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from baselines.optional import import_optional
from baselines.protocol import CannotServe
from baselines.renderformer.triangle_scene import Triangles
from gpf.scene.pinhole import Pinhole

TEXTURE = 32
# Longest edge of the facets in the authors' walls, in a scene of size 1.
EDGE = np.sqrt(2) / 8
LAMPS = 8
# Mean unshadowed irradiance of the 15 examples that came with the code: 2.0 to 5.9, median 3.1.
IRRADIANCE = 3.0


@dataclass(frozen=True)
class Placement:
    """The normalisation of a scene: ``(point - centre) * scale``."""

    centre: np.ndarray
    scale: float

    def place(self, triangles: Triangles) -> Triangles:
        """The triangles, moved into the box from -½ to ½."""
        return replace(triangles, corners=(triangles.corners - self.centre) * self.scale)

    def place_camera(self, camera: Pinhole) -> np.ndarray:
        """The camera's matrix in the file, (4, 4): y up and z backwards."""
        matrix = camera.pose @ np.diag([1.0, -1.0, -1.0, 1.0])
        matrix[:3, 3] = (camera.origin - self.centre) * self.scale
        return matrix


@dataclass(frozen=True)
class Lighting:
    """The lamps of one colour.

    Attributes
    ----------
    emission: that of each triangle in the file, the same in all channels, (N,).
    colour: factor for the network's image, (3,).
    """

    emission: np.ndarray
    colour: np.ndarray


def find_placement(triangles: Triangles) -> Placement:
    """The placement with the largest scale at which everything fits."""
    low, high = (triangles.corners.reshape(-1, 3).min(0), triangles.corners.reshape(-1, 3).max(0))
    return Placement((low + high) / 2, 1 / float((high - low).max()))


def split_lights(triangles: Triangles, where: str) -> list[Lighting]:
    """One lighting per lamp colour, for placed triangles.

    Raises
    ------
    CannotServe: a colour has more lamps than the network was trained with.
    """
    strongest = triangles.radiance.max(axis=1)
    lit = np.flatnonzero(strongest > 0)
    hues = np.round(triangles.radiance[lit] / strongest[lit, None], 3)
    lightings = []
    for hue in np.unique(hues, axis=0):
        lamps = lit[(hues == hue).all(axis=1)]
        if len(lamps) > LAMPS:
            raise CannotServe(
                where,
                f"has {len(lamps)} glowing triangles of one colour; {LAMPS} are allowed",
                "Build the lamps from fewer triangles, or leave the system out for this scene.",
            )
        emission = np.zeros(len(triangles))
        emission[lamps] = strongest[lamps]
        strength = IRRADIANCE / mean_irradiance(triangles, emission)
        lightings.append(Lighting(emission * strength, hue / strength))
    return lightings


def mean_irradiance(triangles: Triangles, emission: np.ndarray) -> float:
    """Mean of ``Σ L A |cos| |cos'| / d²`` over the surfaces, to lamps' centres, without shadows."""
    edges = triangles.corners[:, 1:] - triangles.corners[:, :1]
    crossed = np.cross(edges[:, 0], edges[:, 1])
    area = np.linalg.norm(crossed, axis=1) / 2
    normal = crossed / np.maximum(2 * area, 1e-20)[:, None]
    centre = triangles.corners.mean(axis=1)
    received = np.zeros(len(triangles))
    for lamp in np.flatnonzero(emission):
        way = centre[lamp] - centre
        squared = np.maximum((way**2).sum(axis=1), area[lamp])  # at least about the lamp's width
        cosines = np.abs((way * normal).sum(axis=1) * (way @ normal[lamp])) / squared
        received += emission[lamp] * area[lamp] * cosines / squared
    surface = ~triangles.glow
    return float((received * area)[surface].sum() / area[surface].sum())


def write_scene(path: Path, triangles: Triangles, lighting: Lighting) -> None:
    """Write a scene with one lighting; :func:`set_camera` sets its only camera later."""
    h5py = import_optional("h5py", "h5py")
    count = len(triangles)
    flat = np.tile([0.5, 0.5, 1.0], (count, 1))
    columns = [
        triangles.diffuse,
        triangles.specular,
        triangles.roughness[:, None],
        flat,
        np.repeat(lighting.emission[:, None], 3, axis=1),
    ]
    values = np.concatenate(columns, axis=1).astype(np.float32)
    i, j = np.mgrid[:TEXTURE, :TEXTURE]
    texture = values[:, :, None, None] * (i + j <= TEXTURE).astype(np.float32)
    with h5py.File(path, "w") as file:
        pack: dict[str, Any] = {"compression": "gzip", "compression_opts": 1}
        file.create_dataset("triangles", data=triangles.corners.astype(np.float32), **pack)
        file.create_dataset("vn", data=triangles.normals.astype(np.float32), **pack)
        file.create_dataset("texture", data=texture, **pack)
        file.create_dataset("c2w", data=np.eye(4, dtype=np.float32)[None])
        file.create_dataset("fov", data=np.zeros(1, dtype=np.float32))


def set_camera(path: Path, matrix: np.ndarray, fov: float) -> None:
    """Set the camera of a file: ``matrix`` (4, 4), ``fov`` in degrees."""
    h5py = import_optional("h5py", "h5py")
    with h5py.File(path, "r+") as file:
        file["c2w"][...] = matrix[None].astype(np.float32)
        file["fov"][...] = np.float32(fov)
