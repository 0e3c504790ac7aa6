"""A field as a PLY file for viewers of 3D Gaussian splats.

A viewer draws splats over each other, the nearest in front; the field takes the mean of the
Gaussians around a point of a surface. Three changes bring the viewer's picture closer to the field:

- Splats are flat. The field is queried only on surfaces, but a viewer would also show the extent of
  a Gaussian above and below them: fog in front of walls, tables as thick as their splats. Only the
  slice along the surface is kept, which is the part that a query uses.
- Splats are narrower than the slices. Neighbours overlap several times: drawn over each other,
  they blur details, unlike their mean, and reach beyond edges.
- Splats are nearly opaque, like the surfaces.

PSNR of splatted views against E / π in veach_bidir: 14 to 19 dB with unchanged Gaussians, 1 to 4 dB
more with flat ones, another 1 to 3 dB with narrower ones. The file is for looking at light and does
not replace rendering: a viewer has no textures, glass or lamps.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gpf.core.images import tone_map
from gpf.core.ply import write_ply
from gpf.core.vectors import normalise
from gpf.field.io import StoredField

# The properties of a vertex, in the order in which viewers expect them; all are float32.
PROPERTIES = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)

# Y_00, the constant spherical harmonic: viewers show 0.5 + Y_00 f_dc.
HARMONIC = 0.28209479177387814

OPACITY = 0.9
# Extent of a splat in the surface, as a share of the slice's extent. A smaller one leaves gaps.
NARROWING = 0.7
# Thickness of a splat along the normal, as a share of its smaller extent in the surface.
THICKNESS = 0.1

# Value of the median Gaussian if the exposure is not known: the grey of 18% reflectance.
MIDDLE_GREY = 0.18


def write_splats(path: Path, stored: StoredField, exposure: float) -> int:
    """Write one splat for each Gaussian in a cell of its own level; return their number.

    Vertices are little-endian float32 in the order of :data:`PROPERTIES`: position, normal, colour
    as (c - 1/2) / Y_00 with c = sRGB of ``exposure`` times :func:`white_radiance`, opacity as its
    logit, extents as their logarithms, rotation as w, x, y, z.

    Raises
    ------
    UserError: the file cannot be written.
    """
    t, detail = stored.tensors, stored.detail()
    colour = tone_map(white_radiance(stored), exposure)
    log_scales, rotations = flatten(t["log_scales"], t["quats"], t["normals"])
    log_scales = log_scales + np.log([NARROWING, NARROWING, NARROWING * THICKNESS])
    opacity = np.full((len(colour), 1), np.log(OPACITY / (1 - OPACITY)))
    columns = (t["means"], t["normals"], (colour - 0.5) / HARMONIC, opacity, log_scales, rotations)
    table = np.concatenate(columns, axis=1)
    if detail is not None:
        # Gaussians beside the cells of their level only serve queries within those cells.
        table = table[t["levels"] == detail.levels_at(t["means"])]
    write_ply(path, {" ".join(PROPERTIES): table})
    return len(table)


def white_radiance(stored: StoredField) -> np.ndarray:
    """Radiance that a white surface reflects at each Gaussian, E / π, (N, 3); or the stored
    radiance."""
    value = stored.tensors["irradiance"].astype(float)
    return value / np.pi if stored.settings.stores == "irradiance" else value


def propose_exposure(stored: StoredField) -> float:
    """The exposure that turns the median of the lit Gaussians into :data:`MIDDLE_GREY`."""
    grey = white_radiance(stored).mean(axis=1)
    lit = grey[grey > 0]
    return float(MIDDLE_GREY / np.median(lit)) if len(lit) else 1.0


def flatten(
    log_scales: np.ndarray, quats: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Slices of Gaussians along the surface through their means.

    With two unit vectors T perpendicular to the normal n, the slice's covariance is
    (Tᵀ Σ⁻¹ T)⁻¹ = ((M T)ᵀ M T)⁻¹: its extents are one over the singular values of M T
    (see :mod:`gpf.field.gaussians`).

    Parameters
    ----------
    log_scales, quats, normals: as in :class:`gpf.field.gaussians.Gaussians`, (N, 3), (N, 4) and
        (N, 3).

    Returns
    -------
    log_scales: logarithms of the smaller, the larger and again the smaller extent, (N, 3).
    rotations: unit quaternions (w, x, y, z) of frames whose third axis is n, (N, 4).
    """
    n = normalise(normals.astype(float))
    # Two tangents: from the axis least parallel to n, and perpendicular to both.
    first = normalise(np.cross(n, np.eye(3)[np.abs(n).argmin(axis=1)]))
    tangents = np.stack([first, np.cross(n, first)], axis=2)
    local = Rotation.from_quat(quats).as_matrix().transpose(0, 2, 1)
    whitened = np.exp(-log_scales.astype(float))[:, :, None] * (local @ tangents)
    _, singular, turned = np.linalg.svd(whitened, full_matrices=False)
    frames = np.concatenate([tangents @ turned.transpose(0, 2, 1), n[:, :, None]], axis=2)
    frames[:, :, 1] *= np.sign(np.linalg.det(frames))[:, None]  # no reflections
    smaller, larger = -np.log(singular).T
    xyzw = Rotation.from_matrix(frames).as_quat()
    return np.stack([smaller, larger, smaller], axis=1), xyzw[:, [3, 0, 1, 2]]
