"""Regions of an image in which errors have different causes.

Every pixel belongs to the first region whose condition it meets:

- glass: most camera rays of the pixel are refracted or reflected before they end;
- edge: rays of the pixel end on different surfaces;
- caustic: light changes by more than a fifth over two pixels;
- rest.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from scipy.ndimage import median_filter

from gpf.camera.film import sample_film
from gpf.core.structs import to_numpy
from report.figures.places import arriving_light

REGIONS = ("glass", "edge", "caustic", "rest")
RAYS = 16
CHANGE = 0.2


def find_regions(scene: mi.Scene, sensor: mi.Sensor, layers: dict[str, np.ndarray]) -> np.ndarray:
    """The number of each pixel's region, (H W,); ``layers``: those of the view's reference."""
    films = [sample_film(scene, sensor, seed) for seed in range(RAYS)]
    points = [film.points for film in films]
    valid = np.stack([to_numpy(p.valid) for p in points])
    through = np.mean([to_numpy(p.depth) > 0 for p in points], axis=0) > 0.5
    normals = np.stack([to_numpy(p.n) for p in points])
    positions = np.stack([to_numpy(p.p) for p in points])
    # Points on one plane have offsets perpendicular to the normal, at any viewing angle.
    offset = positions - positions[0]
    off_plane = np.abs((offset * normals[0]).sum(axis=2)).max(axis=0)
    along = np.linalg.norm(offset, axis=2).max(axis=0)
    turned = ((normals * normals[0]).sum(axis=2).min(axis=0) < 0.9) & valid.any(axis=0)
    edge = turned | (off_plane > 0.2 * along + 1e-6) | (valid != valid[0]).any(axis=0)
    lit = layers["valid"].ravel() > 0.5
    level = arriving_light(layers["radiance"], layers["reflectance"]).mean(axis=2)
    around = median_filter(level, 5)
    steep = (np.abs(level - around) > CHANGE * np.maximum(around, 1e-6)).ravel() & lit
    region = np.full(lit.size, REGIONS.index("rest"))
    for name, mask in (
        ("caustic", steep),
        ("edge", edge),
        ("glass", through),
    ):
        region[mask] = REGIONS.index(name)
    return region
