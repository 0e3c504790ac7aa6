"""Light in media at fixed places, from the photons of many passes, and the field that it gives.

A field in media is made like one on surfaces: as fine at each place as two independent halves of
the photons allow, trained on all of them, and without the detail that the halves do not share.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.film import sample_film
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import SurfacePoints, from_numpy, to_numpy
from gpf.field.by_detail import place_by_detail
from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.field.volume import VolumeField
from gpf.photons.density import PhotonCloud
from gpf.photons.photon_cells import PhotonCells
from gpf.photons.photon_grid import PhotonSums
from gpf.photons.tracing import PathSettings, record_all
from gpf.scene.bounds import scene_bounds
from gpf.sppm.passes import propose_media_radius, radius_at
from gpf.training.blend_matrix import blend_matrix
from gpf.training.detail_choice import choose_detail
from gpf.training.half_colours import HalfColours
from gpf.training.settings import TrainingSettings
from gpf.training.shared_detail import keep_shared_detail
from gpf.training.trainer import Trainer

# Edge of the cells in which photons are added up, in kernel radii after TYPICAL_PASSES passes.
CELL, TYPICAL_PASSES = 0.25, 100

FROM_VIEWS, FROM_PHOTONS = 150_000, 50_000
"""Largest numbers of places that cameras look through, and of places of photons."""

INSIDE = 32
"""Points in a kernel's ball, per place, that tell how much of it lies in the medium."""

ROUNDS = 30
"""Steps of the solver that fits the moments."""


class VolumeLight:
    """Light in media at places, from photons that are added up in cells: odd-numbered and
    even-numbered passes separately.

    Parameters
    ----------
    settings: the photon paths of a pass.
    alpha: radius reduction.

    Attributes
    ----------
    sums: takes the photons.
    indirect: whether photons straight from a lamp are left out.
    """

    def __init__(
        self,
        scene: mi.Scene,
        sensors: Mapping[str, mi.Sensor],
        settings: PathSettings,
        alpha: float,
        seed: int,
    ) -> None:
        self.scene, self.seed, self._alpha = scene, seed, alpha
        self.indirect = settings.indirect
        self._bounds = scene_bounds(scene)
        self._first = propose_media_radius(scene, settings, seed, self._bounds)
        self.places = find_places(scene, sensors, settings, seed)
        cell = CELL * self.radius(TYPICAL_PASSES)
        self.sums = PhotonSums(PhotonCells(cell, self._bounds, self.places), settings)

    def radius(self, passes: int) -> float:
        """Radius of the kernel after so many passes, world units."""
        return radius_at(max(passes, 1), self._first, self._alpha, dimensions=3)

    def halves(self, passes: int) -> tuple[tuple[SurfacePoints, SurfacePoints], np.ndarray]:
        """The places with the fluence from each half of the photons, and the moments from all of
        them, (P, 3)."""
        p = from_numpy(mi.Point3f, self.places)
        # Without a direction: in media, there are no sides.
        n = dr.zeros(mi.Normal3f, len(self.places))
        radius, found, moments = self.radius(passes), [], np.zeros((len(self.places), 3))
        shares = passes // 2 / passes, (passes + 1) // 2 / passes
        for half, share in enumerate(shares):
            cloud = PhotonCloud(self.sums.photons(half), radius, self._bounds)
            inside = share_inside(self.scene, p, radius, pass_seed(self.seed, half, Stream.EDGES))
            fluence, moment = (value / inside for value in cloud.fluence(p))
            dr.eval(fluence, moment)
            found.append(SurfacePoints(p=p, n=n, target=fluence))
            moments += share * to_numpy(moment)
            del cloud
            dr.flush_malloc_cache()
        return (found[0], found[1]), moments.astype(np.float32)


def find_places(
    scene: mi.Scene, sensors: Mapping[str, mi.Sensor], settings: PathSettings, seed: int
) -> np.ndarray:
    """Places in media where light is needed, world units, (P, 3) float32: some of those that
    cameras look through, and some of those of photons."""
    seen = []
    for number, sensor in enumerate(sensors.values()):
        haze = sample_film(scene, sensor, pass_seed(seed, number, Stream.VOLUME_VIEWS)).haze
        seen.append(to_numpy(dr.gather(mi.Point3f, haze.p, dr.compress(haze.valid))))
    _, photons = record_all(scene, settings, pass_seed(seed, 0, Stream.VOLUME_PHOTONS))
    rng = np.random.default_rng(seed)
    parts = (np.concatenate(seen), FROM_VIEWS), (to_numpy(photons.p), FROM_PHOTONS)
    return np.concatenate([rng.permutation(p)[:most] for p, most in parts]).astype(np.float32)


def share_inside(scene: mi.Scene, p: mi.Point3f, radius: float, seed: int) -> mi.Float:
    """How much of a ball around places is not cut off by surfaces, (N,); no photon is beyond."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, dr.width(p))
    start = dr.zeros(mi.Interaction3f, dr.width(p))
    start.p = p
    free = mi.Float(0)
    for _ in range(INSIDE):
        length = dr.opaque(mi.Float, radius) * sampler.next_1d() ** (1 / 3)
        d = mi.warp.square_to_uniform_sphere(sampler.next_2d())
        ray = start.spawn_ray_to(p + length * d)
        free += dr.select(scene.ray_test(ray), 0, 1)
        dr.eval(free)
    return dr.maximum(free, 1) / INSIDE


def fit_volume(
    light: VolumeLight,
    passes: int,
    settings: Callable[[float], FieldSettings],
    training: TrainingSettings,
) -> VolumeField:
    """The field in media from the photons of so many passes.

    ``settings``: those of the field, given its search radius.
    """
    halves, moments = light.halves(passes)
    mean = replace(halves[0], target=(halves[0].target + halves[1].target) / 2)
    bounds = scene_bounds(light.scene)
    detail = choose_detail(mean, halves, light.radius(passes), bounds)
    nowhere = np.zeros_like(light.places)
    gaussians = place_by_detail(detail, light.places, nowhere, training.seed)
    own = settings(detail.radius).model_copy(update={"normal_test": False})
    field = GaussianPhotonField(gaussians, own, bounds, detail=detail)
    field = Trainer(field, mean, training).run()
    field.recolour(keep_shared_detail(field, HalfColours.fit(field, halves)))
    return VolumeField(field, fit_moments(field, mean, moments), light.indirect)


def fit_moments(
    field: GaussianPhotonField, points: SurfacePoints, moments: np.ndarray
) -> np.ndarray:
    """The moments of the Gaussians, (N, 3), by least squares, relative to the fluence."""
    from scipy.sparse import diags_array  # slow to import
    from scipy.sparse.linalg import lsqr

    matrix = blend_matrix(field, points)
    level = (matrix @ to_numpy(field.gaussians.irradiance)).mean(axis=1)
    weight = 1 / np.maximum(level, 1e-3 * max(float(level.mean()), 1e-20))
    rows: Any = diags_array(weight.astype(np.float32)) @ matrix
    found = [lsqr(rows, weight * m, damp=1e-3, iter_lim=ROUNDS)[0] for m in moments.T]
    return np.stack(found, axis=1).astype(np.float32)
