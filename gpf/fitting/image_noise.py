"""The noise of a field's images, from their camera samples."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.rays import sample_rays_at
from gpf.core.images import tone_map
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import from_numpy
from gpf.field.field import GaussianPhotonField
from gpf.rendering.adaptive import sample_adaptively
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings

# The noise is measured in square patches of the views: pixels along a side of a patch, and in all
# patches together.
PATCH, PATCH_PIXELS = 16, 8192
IMAGE = RenderSettings()


def measure_image_noise(
    scene: mi.Scene,
    sensors: Sequence[mi.Sensor],
    field: GaussianPhotonField,
    exposure: float,
    seed: int,
) -> np.ndarray:
    """Mean squared error of tone-mapped images from their camera samples alone, for each view,
    (V,).

    Patches of the views are sampled like an image: adaptively, and with little weight for
    fireflies, which would otherwise dominate the result. Two independent images of them are
    compared.
    """
    renderer = FieldRenderer.make(scene, field, IMAGE)
    films = [[int(n) for n in sensor.film().crop_size()] for sensor in sensors]
    side = min(PATCH, *(n for film in films for n in film))
    each = max(1, PATCH_PIXELS // (side * side * len(films)))
    rng = np.random.default_rng(pass_seed(seed, 1, Stream.QUALITY_PIXELS))
    corners = np.concatenate(
        [rng.integers(0, [n - side + 1 for n in film], (each, 2)) for film in films]
    )
    corner = from_numpy(mi.Point2f, corners)

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        number, row = pixel.y // side, pixel.y % side
        inside = mi.Point2f(mi.Float(pixel.x), mi.Float(row)) + sampler.next_2d()
        place = dr.gather(mi.Point2f, corner, number) + inside
        ray = dr.zeros(mi.Ray3f)
        for k, sensor in enumerate(sensors):
            through = mi.Ray3f(sample_rays_at(sensor, sampler, place)[0])
            ray = dr.select(number // each == k, through, ray)
        return [*renderer.integrator.sample(dr.ADMode.Primal, scene, sampler, ray)[0]]

    sampler = mi.load_dict({"type": IMAGE.sampler, "sample_count": IMAGE.spp})
    size = side, side * len(corners)
    shown = []
    for half in (1, 2):
        image_seed = pass_seed(seed, half, Stream.QUALITY_CAMERA)
        image = sample_adaptively(
            sample, sampler, size, IMAGE.spp, image_seed, IMAGE.suppress_fireflies
        )
        shown.append(tone_map(np.array(image), exposure))
    square: np.ndarray = (shown[0] - shown[1]) ** 2 / 2
    return square.reshape(len(films), -1).mean(axis=1)
