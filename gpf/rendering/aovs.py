"""AOVs (arbitrary output variables): what an image from a field can show besides radiance.

===================  ============================================================================
``depth``            distance from the camera to the first surface, world units
``position``         of the first surface, world units
``normal``           shading normal of the first surface, in world space
``albedo``           diffuse reflectance at the visible point, times the throughput of the walk to
                     it: glass and mirrors show the albedo of what is seen in them; where the walk
                     meets nothing diffuse, the light that it finds, at most 1
``visible_normal``   geometric normal at the visible point, in world space
``irradiance``       all light that arrives at the visible point, W/m²: the field's answer, and what
                     the renderer samples from lamps that the field does not store
``coverage``         distance of the farthest Gaussian that was used, in search radii: 1 in well
                     covered regions, more where the nearest Gaussians lie farther away
``error``            expected error of the field's light, as a fraction of the radiance; where it
                     is large, more photons would help. Needs a field with expected errors
===================  ============================================================================

Values are means over the samples of a pixel, and 0 for samples without a surface. The first three
are the same as in Mitsuba's ``aov`` integrator.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.images import tone_slope
from gpf.core.structs import VisiblePoints
from gpf.field.field import GaussianPhotonField

_SUFFIXES = {
    "depth": "",
    "position": "XYZ",
    "normal": "XYZ",
    "albedo": "RGB",
    "visible_normal": "XYZ",
    "irradiance": "RGB",
    "coverage": "",
    "error": "",
}

AOVS = tuple(_SUFFIXES)
"""All names."""

_FIRST_SURFACE = ("depth", "position", "normal")

MOST_ERROR = 1.0
"""Largest relative error that the AOV ``error`` shows. Where nearly black light lies beside
bright light, more would be possible, and a few such samples would dominate an image's error."""

MOST_COVERAGE = 1e6
"""Largest value of the AOV ``coverage``: the film treats infinite ones as zero."""


def parse_aovs(text: str) -> tuple[str, ...]:
    """The names in a comma-separated list, without duplicates; ``ValueError`` for unknown ones."""
    names = tuple(dict.fromkeys(name for part in text.split(",") if (name := part.strip())))
    for name in names:
        if name not in AOVS:
            raise ValueError(f'"aovs": unknown name {name!r}; choose from {", ".join(AOVS)}.')
    return names


def channel_names(aovs: Sequence[str]) -> list[str]:
    """The names of the channels of some AOVs, in order."""
    return [
        channel
        for name in aovs
        for channel in ([f"{name}.{letter}" for letter in _SUFFIXES[name]] or [name])
    ]


def channels(aovs: Sequence[str], values: Mapping[str, Any]) -> list[mi.Float]:
    """The channels of some AOVs, in order, (N,) each."""
    return [
        channel
        for name in aovs
        for channel in (values[name] if _SUFFIXES[name] else [values[name]])
    ]


def split_layers(image: np.ndarray, aovs: Sequence[str]) -> dict[str, np.ndarray]:
    """Split an image with the channels R, G, B and some AOVs, (H, W, C), into layers: its
    ``radiance``, (H, W, 3), and each AOV, (H, W, 3) or (H, W)."""
    layers, first = {"radiance": image[..., :3]}, 3
    for name in aovs:
        count = len(_SUFFIXES[name]) or 1
        part = image[..., first : first + count]
        layers[name] = part if count > 1 else part[..., 0]
        first += count
    return layers


def expected_psnr(radiance: np.ndarray, error: np.ndarray, exposure: float) -> float:
    """The PSNR of an image with the AOV ``error`` e, without the noise of its camera samples, dB:

        -10 log10 mean((s e L)²),    s the slope of the tone curve.

    Parameters
    ----------
    radiance: L, W/(m² sr), (H, W, 3).
    error: e, (H, W).
    """
    level = np.maximum(radiance, 0)
    wrong = tone_slope(level, exposure) * error[..., None] * level
    return float(-10 * np.log10(max(float(np.mean(wrong**2)), 1e-10)))


def at_first_surface(
    scene: mi.Scene, ray: mi.Ray3f, aovs: Sequence[str], active: mi.Bool
) -> dict[str, Any]:
    """The requested AOVs that belong to the first surface."""
    wanted = [name for name in aovs if name in _FIRST_SURFACE]
    if not wanted:
        return {}
    si = scene.ray_intersect(ray, mi.RayFlags.All, coherent=True, active=active)
    hit = active & si.is_valid()
    values = {"depth": si.t, "position": si.p, "normal": mi.Vector3f(si.sh_frame.n)}
    return {name: dr.select(hit, values[name], 0) for name in wanted}


def at_visible_point(
    field: GaussianPhotonField,
    points: VisiblePoints,
    irradiance: mi.Color3f,
    sampled: mi.Color3f,
    reach: mi.Float,
    share: mi.Float,
    unsure: mi.Color3f,
    aovs: Sequence[str],
) -> dict[str, Any]:
    """The requested AOVs that belong to the visible point.

    Parameters
    ----------
    irradiance, reach: the field's answer at the points; see
        :meth:`gpf.field.field.GaussianPhotonField.query`.
    sampled: irradiance from lamps that the field does not store, W/m², (N, 3).
    share: weights of the points, (N,), in a mean over several per camera ray.
    unsure: expected error of the light in media on the way, W/(m² sr), (N, 3).
    """
    values = {
        "albedo": dr.select(
            points.valid,
            points.throughput * points.reflectance,
            dr.clip(points.emission, 0, share),
        ),
        "visible_normal": dr.select(points.valid, share * mi.Vector3f(points.n), 0),
        "irradiance": dr.select(points.valid, share * (irradiance + sampled), 0),
        "coverage": dr.select(points.valid, share * dr.minimum(reach, MOST_COVERAGE), 0),
    }
    if "error" in aovs:
        radiance = dr.sum(field.reflect(points, irradiance)) / 3
        dark = field.reflect(points, mi.Color3f(0))
        error, _ = field.part("error").query(points.p, points.n, points.valid)
        wrong = field.reflect(points, error) - dark
        error = dr.sum(wrong) / 3
        if field.volume is not None:
            error = dr.sqrt(dr.square(error) + dr.square(dr.sum(unsure) / 3))
        relative = dr.minimum(error / radiance, MOST_ERROR)
        values["error"] = dr.select(radiance > 0, share * relative, 0)
    return {name: values[name] for name in aovs if name in values}
