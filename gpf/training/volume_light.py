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
from gpf.core.structs import Photons, SurfacePoints, from_numpy, to_numpy
from gpf.field.by_detail import place_by_detail
from gpf.field.field import GaussianPhotonField
from gpf.field.lights import FieldLights
from gpf.field.limits import find_limits_in_space
from gpf.field.neighbour_search import LARGEST_REACH
from gpf.field.settings import FieldSettings
from gpf.field.volume import VolumeField
from gpf.photons.density import PhotonCloud
from gpf.photons.photon_cells import PhotonCells
from gpf.photons.photon_grid import PhotonSums, trace_pass
from gpf.photons.tracing import PathSettings, record_all
from gpf.scene.bounds import box_around, scene_bounds
from gpf.scene.light_groups import LightGroups
from gpf.scene.media import Media
from gpf.sppm.edge_correction import ball_correction
from gpf.sppm.passes import propose_media_radius, radius_at
from gpf.training.blend_matrix import blend_matrix
from gpf.training.detail_choice import choose_detail
from gpf.training.field_error import estimate_error
from gpf.training.half_colours import HalfColours
from gpf.training.light_split import split_light
from gpf.training.settings import TrainingSettings
from gpf.training.shared_detail import keep_shared_detail
from gpf.training.trainer import Trainer

# Edge of the cells in which photons are added up, in kernel radii after TYPICAL_PASSES passes.
CELL, TYPICAL_PASSES = 0.75, 100

FROM_VIEWS, FROM_PHOTONS, FROM_BOX = 150_000, 50_000, 20_000
"""Largest numbers of places that cameras look through, of places of photons, and of places anywhere
around: no photon comes to a dark one."""

CORRECTIONS = 8
"""Estimates of how much of a kernel's ball is cut off by surfaces, per place."""

DISTANCE = 0.7
"""Distance between Gaussians in space, in search radii."""

ROUNDS, RIDGE = 30, 1e-6
"""Steps of the solver that fits the moments, and what is added to the diagonal of its matrix,
relative to its mean."""


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
    bounds: corners of the box around all places and their kernels.
    indirect: whether photons straight from a lamp are left out.
    """

    def __init__(
        self,
        scene: mi.Scene,
        sensors: Mapping[str, mi.Sensor],
        settings: PathSettings,
        alpha: float,
        seed: int,
        groups: LightGroups | None = None,
    ) -> None:
        self.scene, self.seed, self._alpha = scene, seed, alpha
        self.indirect = settings.indirect
        self._first = propose_media_radius(scene, settings, seed, scene_bounds(scene))
        self.places = find_places(scene, sensors, settings, seed)
        # The kernels of the outermost places reach farther.
        reach = self._first * np.array([[-1.0], [1.0]])
        ends = np.stack([self.places.min(axis=0), self.places.max(axis=0)]) + reach
        self.bounds = box_around(from_numpy(mi.Point3f, ends))
        cell = CELL * self.radius(TYPICAL_PASSES)
        table = None if groups is None else groups.table(scene)
        cells = PhotonCells(cell, self.bounds, self.places, dimensions=3)
        self.sums = PhotonSums(cells, settings, groups=table, floating=True)

    def add_pass(self, number: int) -> None:
        """Trace pass ``number``, counted from 1, for these photons alone."""
        seed = pass_seed(self.seed, number, Stream.PHOTONS)
        trace_pass(self.scene, seed, number % 2, None, self.sums)

    def radius(self, passes: int) -> float:
        """Radius of the kernel after so many passes, world units."""
        return radius_at(max(passes, 1), self._first, self._alpha, dimensions=3)

    def halves(
        self, passes: int, stride: int = 1
    ) -> tuple[tuple[SurfacePoints, SurfacePoints], np.ndarray]:
        """Every ``stride``-th place with the fluence from each half of the photons, and the moments
        from all of them, (P, 2, 3, 4), as in :class:`gpf.field.volume.VolumeField`."""
        places, found = self.places[::stride], []
        moments = np.zeros((len(places), 2, 3, 4), np.float32)
        # Without a direction: in media, there are no sides.
        p, n = from_numpy(mi.Point3f, places), dr.zeros(mi.Normal3f, len(places))
        for half, share in enumerate(_shares(passes)):
            correction = self._correction(p, passes, half)
            fluence, moment = self._estimate(p, passes, half)
            target = from_numpy(mi.Color3f, correction * fluence)
            found.append(SurfacePoints(p=p, n=n, target=target))
            moments += share * correction[:, :, None, None] * moment
        return (found[0], found[1]), moments

    def by_group(
        self, groups: LightGroups, passes: int, stride: int = 1
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fluence and moments from each group of emitters at every ``stride``-th place, from all
        photons, (G, P, 3) and (G, P, 2, 3, 4)."""
        p = from_numpy(mi.Point3f, self.places[::stride])
        correction = self._correction(p, passes, number=2)
        fluences = np.zeros((len(groups.names), dr.width(p), 3), np.float32)
        moments = np.zeros((len(fluences), dr.width(p), 2, 3, 4), np.float32)
        for group in range(len(fluences)):
            for half, share in enumerate(_shares(passes)):
                fluence, moment = self._estimate(p, passes, half, group)
                fluences[group] += share * correction * fluence
                moments[group] += share * correction[:, :, None, None] * moment
        return fluences, moments

    def _estimate(
        self, p: mi.Point3f, passes: int, half: int, group: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fluence and moments at places, (P, 3) and (P, 2, 3, 4), too dark near surfaces."""
        every = self._moments(p, passes, self.sums.photons(half, group))
        straight = self._moments(p, passes, self.sums.photons(half, group, diffused=False))
        return every[:, :, 3], np.stack([straight, every - straight], axis=1)

    def _moments(self, p: mi.Point3f, passes: int, photons: Photons) -> np.ndarray:
        """J and φ of each channel at places, (P, 3, 4)."""
        cloud = PhotonCloud(photons, self.radius(passes))
        fluence, moments = cloud.fluence(p)
        directions = np.stack([to_numpy(moment) for moment in moments], axis=1)
        found = np.concatenate([directions, to_numpy(fluence)[:, :, None]], axis=2)
        del cloud, fluence, moments
        dr.flush_malloc_cache()
        return found

    def _correction(self, p: mi.Point3f, passes: int, number: int) -> np.ndarray:
        """Factors for what the kernels lose to surfaces, (P, 1) float32. ``number`` selects the
        random numbers: what the halves have in common passes for light."""
        total, every = np.zeros(dr.width(p), np.float32), dr.full(mi.Bool, True, dr.width(p))
        for k in range(CORRECTIONS):
            seed = pass_seed(self.seed, CORRECTIONS * number + k, Stream.EDGES)
            total += ball_correction(self.scene, p, every, self.radius(passes), seed).numpy()
        return total[:, None] / CORRECTIONS


def _shares(passes: int) -> tuple[float, float]:
    """The shares of the two halves of the passes."""
    return passes // 2 / passes, (passes + 1) // 2 / passes


def find_places(
    scene: mi.Scene, sensors: Mapping[str, mi.Sensor], settings: PathSettings, seed: int
) -> np.ndarray:
    """Places in media where light is needed, world units, (P, 3) float32: some of those that
    cameras look through, some of those of photons, and some anywhere."""
    seen = []
    for number, sensor in enumerate(sensors.values()):
        haze = sample_film(scene, sensor, pass_seed(seed, number, Stream.VOLUME_VIEWS)).haze
        seen.append(to_numpy(dr.gather(mi.Point3f, haze.p, dr.compress(haze.valid))))
    _, photons = record_all(scene, settings, pass_seed(seed, 0, Stream.VOLUME_PHOTONS))
    rng = np.random.default_rng(seed)
    parts = (np.concatenate(seen), FROM_VIEWS), (to_numpy(photons.p), FROM_PHOTONS)
    found = [rng.permutation(p)[:most] for p, most in parts]
    return np.concatenate([*found, _anywhere(scene, rng)]).astype(np.float32)


def _anywhere(scene: mi.Scene, rng: np.random.Generator) -> np.ndarray:
    """Places in media, evenly distributed over a box twice as long as the scene's, (P, 3)."""
    lower, upper = (np.array(corner) for corner in scene_bounds(scene))
    rim = (upper - lower) / 2
    places = rng.uniform(lower - rim, upper + rim, (FROM_BOX, 3))
    ray = mi.Ray3f(from_numpy(mi.Point3f, places), mi.Vector3f(0, 0, 1))
    medium = Media(scene).around(ray, dr.full(mi.Bool, True, FROM_BOX))
    return places[(medium != None).numpy()]  # noqa: E711  # one answer per lane


def fit_volume(
    light: VolumeLight,
    passes: int,
    stride: int,
    settings: Callable[[float], FieldSettings],
    training: TrainingSettings,
    groups: LightGroups | None = None,
) -> VolumeField:
    """The field in media from the photons of so many passes, at every ``stride``-th place.

    ``settings``: those of the field, given its search radius.
    """
    halves, moments = light.halves(passes, stride)
    mean = replace(halves[0], target=(halves[0].target + halves[1].target) / 2)
    detail = choose_detail(mean, halves, light.radius(passes), light.bounds)
    places = light.places[::stride]
    gaussians = place_by_detail(detail, places, np.zeros_like(places), training.seed, DISTANCE)
    direct: Any = "emitters" if light.indirect else "field"
    own = settings(detail.radius).model_copy(update={"normal_test": False, "direct": direct})
    ends = find_limits_in_space(light.scene, gaussians, detail, LARGEST_REACH)
    field = GaussianPhotonField(gaussians, own, light.bounds, detail=detail, limits=ends)
    field = Trainer(field, mean, training).run()
    fitted = HalfColours.fit(field, halves)
    keep_shared_detail(field, fitted)
    field.set_error(estimate_error(field, fitted, np.zeros(len(places))))
    if groups is None:
        return VolumeField(field, fit_moments(field, mean, moments))
    fluences, parts = light.by_group(groups, passes, stride)
    field.lights = FieldLights(groups, split_light(field, mean, fluences))
    each = np.stack([fit_moments(field, mean, part) for part in parts])
    return VolumeField(field, each.sum(axis=0), each)


def fit_moments(
    field: GaussianPhotonField, points: SurfacePoints, moments: np.ndarray
) -> np.ndarray:
    """The moments of the Gaussians, (N, 2, 3, 4), from those at points, (P, 2, 3, 4), by least
    squares, relative to the fluence."""
    from scipy.sparse import diags_array  # slow to import
    from scipy.sparse.linalg import cg

    matrix = blend_matrix(field, points)
    level = (matrix @ to_numpy(field.gaussians.irradiance)).mean(axis=1)
    unit = max(float(level.mean()), 1e-20)
    weight = np.square(1 / np.maximum(level / unit, 1e-3)).astype(np.float32)
    back = (diags_array(weight) @ matrix).T.tocsr()
    normal = back @ matrix
    normal += diags_array(np.full(normal.shape[0], RIDGE * normal.diagonal().mean(), np.float32))
    wanted = back @ (moments.reshape(len(moments), -1) / unit)
    found = [cg(normal, column, maxiter=ROUNDS)[0] for column in wanted.T]
    return (unit * np.stack(found, axis=1)).reshape(-1, *moments.shape[1:]).astype(np.float32)
