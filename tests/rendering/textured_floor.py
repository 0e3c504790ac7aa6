"""A textured floor with one texel per pixel, and a field with the same irradiance all over it."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

import gpf  # noqa: F401  # registers the plugins
from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from tests.plain_field import flat_gaussians, to_device

WIDTH, HEIGHT = 8, 6
E = np.array([2.0, 3.0, 5.0])
LAMP = np.array([0.5, 0.25, 4.0])
TEXELS = np.random.default_rng(4).uniform(0.05, 0.95, (HEIGHT, WIDTH, 3)).astype(np.float32)


def constant_field(stores: str = "irradiance") -> GaussianPhotonField:
    """E everywhere on the floor, but for its far left end, where no Gaussian is near."""
    grid = np.stack(np.meshgrid(np.linspace(-2, 4, 13), np.linspace(-3, 3, 13)), -1).reshape(-1, 2)
    means = np.column_stack([grid, np.zeros(len(grid))])
    g = flat_gaussians(means, np.tile(E, (len(means), 1)), size=0.3)
    corners = mi.ScalarPoint3f(-4, -3, 0), mi.ScalarPoint3f(4, 3, 0.5)
    return GaussianPhotonField(
        to_device(g), FieldSettings(search_radius=0.8, stores=stores), corners
    )


def make_scene(pixels: str = "rgb") -> mi.Scene:
    """A floor with one texel per pixel; one of the pixels looks at a lamp's black front."""
    t = mi.ScalarTransform4f
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": {
                "type": "orthographic",
                "to_world": t().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]).scale([4, 4, 1]),
                "sampler": {"type": "independent"},
                "film": {
                    "type": "hdrfilm",
                    "width": WIDTH,
                    "height": HEIGHT,
                    "rfilter": {"type": "box"},
                    "pixel_format": pixels,
                    "component_format": "float32",
                },
            },
            "floor": {
                "type": "rectangle",
                "to_world": t().scale([4, 3, 1]),
                "bsdf": {
                    "type": "diffuse",
                    "reflectance": {
                        "type": "bitmap",
                        "bitmap": mi.Bitmap(TEXELS),
                        "raw": True,
                        "filter_type": "nearest",
                    },
                },
            },
            "lamp": {
                "type": "rectangle",
                "to_world": t().translate([2.5, 1.5, 0.5]).scale(0.5),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}},
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": LAMP.tolist()}},
            },
        }
    )


def integrator_with(field: GaussianPhotonField, **more) -> mi.Integrator:
    integrator = mi.load_dict({"type": "gpf", **more})
    integrator.field = field
    return integrator
