"""Reference images and training targets: many passes of SPPM; several views share the photons."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.random import pass_seed, random_start, stream_of
from gpf.core.structs import VisiblePoints, concatenate, take, to_numpy
from gpf.photons.emission import Source, emit_light
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings, PhotonPasses
from stages.references.pass_sums import ExactSum, PassSums
from stages.references.view_samples import fixed_points, sample_view


@dataclass(frozen=True)
class ReferenceView:
    """The result of many passes for one view.

    Attributes
    ----------
    radiance: mean over passes, each with a new sample in every pixel, W/(m² sr), (H, W, 3); None
        for a view without an image.
    standard_error: standard error of the radiance, from its variance between passes, (H, W, 3);
        None for a view without an image.
    position, normal, reflectance: those of one fixed visible point per pixel, (H, W, 3).
    irradiance: mean over passes at these points, W/m², (H, W, 3); None for a view without points.
    direct: the part of the irradiance from samples of the emitters, (H, W, 3); 0 if photons carry
        direct light; None for a view without points.
    valid: 1 where the pixel has a visible point, else 0, (H, W).
    """

    radiance: np.ndarray | None
    standard_error: np.ndarray | None
    position: np.ndarray
    normal: np.ndarray
    reflectance: np.ndarray
    irradiance: np.ndarray | None
    direct: np.ndarray | None
    valid: np.ndarray

    def layers(self) -> dict[str, np.ndarray]:
        """The layers of the EXR file."""
        return {name: layer for name, layer in vars(self).items() if layer is not None}


class ReferenceRenderer:
    """Accumulates passes for a group of views that share their photons.

    A view's result depends on the seed, the settings, and the view's name and camera. It does not
    depend on the other views of the group: all views use the photons of a pass, and each has its
    own camera samples.

    Parameters
    ----------
    sensors: the sensor of each view whose image is accumulated, by name.
    points: sets of fixed points whose irradiance is accumulated, by name: visible points of a view
        (:func:`fixed_points`) or samples of the scene's surfaces.
    source: emits the photons; see :func:`gpf.photons.tracing.trace_photons`.
    """

    def __init__(
        self,
        scene: mi.Scene,
        sensors: Mapping[str, mi.Sensor],
        points: Mapping[str, VisiblePoints],
        settings: PassSettings,
        seed: int,
        source: Source = emit_light,
    ) -> None:
        self.passes = PhotonPasses(scene, settings, seed, source)
        self.settings = self.passes.settings
        self.scene, self.sensors, self.seed = scene, dict(sensors), seed
        self.points = dict(points)
        # Photons are gathered at valid points only, which may be few.
        self._valid = {name: dr.compress(points.valid) for name, points in self.points.items()}
        dr.eval(self.points)
        self._join_points()
        self.sizes = {name: film_size(sensor) for name, sensor in self.sensors.items()}

    def _join_points(self) -> None:
        """Join all sets into one: with a kernel for each, every kernel would wait for its slowest
        point."""
        parts, starts, self._lanes, first = [], [], {}, 0
        for name, valid in self._valid.items():
            count = dr.width(valid)
            if count > 0:
                stream = stream_of(f"points {name}")
                starts.append(random_start(pass_seed(self.seed, 0, stream), count))
                parts.append(take(self.points[name], valid))
                self._lanes[name] = dr.arange(mi.UInt32, first, first + count)
                first += count
        self._joined = FixedPoints(self.scene, concatenate(parts)) if parts else None
        self._start = concatenate(starts) if parts else mi.Point2f()
        dr.eval(self._lanes, self._start)

    def empty_sums(self) -> PassSums:
        """Sums over no passes, with the shapes of this group."""
        pixels = {name: width * height for name, (width, height) in self.sizes.items()}
        points = {name: dr.width(lanes) for name, lanes in self._valid.items()}
        return PassSums(pixels, points, separate_direct=self.settings.direct == "emitters")

    def run(
        self,
        passes: int,
        sums: PassSums | None = None,
        tick: Callable[[int], None] = lambda done: None,
    ) -> PassSums:
        """Continue ``sums``, or start with empty sums, until they hold passes 1 to ``passes``.

        ``tick(done)`` is called after each pass.
        """
        sums = sums or self.empty_sums()
        while sums.passes < passes:
            self.run_pass(sums.passes + 1, sums)
            tick(sums.passes)
        return sums

    def run_pass(self, t: int, sums: PassSums) -> None:
        """Add pass ``t`` (counted from 1) to ``sums``."""
        photons = self.passes.trace(t)
        for name, sensor in self.sensors.items():
            film = sample_view(self.scene, sensor, name, self.settings, self.seed, t)
            dr.eval(film)
            radiance = photons.radiance(film.points, film.haze)
            sums.views[name].add(film.merge(radiance), t)
        if self._joined is not None:
            irradiance, direct = photons.all_irradiance(self._joined, self._start, t)
            dr.eval(irradiance)  # otherwise the sum of each set would gather all photons again
            for name, lanes in self._lanes.items():
                sums.points[name].add(dr.gather(mi.Color3f, irradiance, lanes))
                if direct is not None:
                    sums.direct[name].add(dr.gather(mi.Color3f, direct, lanes))
        # Without waiting, unfinished passes queue up and the progress bar runs ahead of them.
        dr.sync_thread()
        sums.passes += 1

    def image(self, name: str, sums: PassSums) -> np.ndarray:
        """Mean radiance of a view over the passes in the sums, (H, W, 3)."""
        return self._grid(name, sums.views[name].mean(sums.passes))

    def _grid(self, name: str, value: np.ndarray) -> np.ndarray:
        width, height = self.sizes[name]
        return value.reshape(height, width, 3).astype(np.float32)

    def view(self, name: str, sums: PassSums, size: tuple[int, int] | None = None) -> ReferenceView:
        """The results of a view: its image, and the set of fixed points of the same name.

        ``size`` is the width and height of the film; a view with an image does not need it.
        """
        width, height = size or self.sizes[name]
        points = self.points.get(name)
        if points is None:
            points = fixed_points(self.scene, self.sensors[name], name, self.settings, self.seed)

        def grid(value: Any) -> np.ndarray:
            array = to_numpy(value)
            return array.reshape(height, width, *array.shape[1:])

        image = standard_error = irradiance = direct = None
        if name in self.points:
            irradiance = self.mean_irradiance(name, sums).reshape(height, width, 3)
            direct = self.mean_direct(name, sums).reshape(height, width, 3)
        if name in self.sensors:
            image = self.image(name, sums)
            tally = sums.views[name]
            standard_error = self._grid(name, tally.standard_error(sums.passes))
        return ReferenceView(
            radiance=image,
            standard_error=standard_error,
            position=grid(points.p),
            normal=grid(dr.select(points.valid, points.n, 0)),
            reflectance=grid(points.reflectance),
            irradiance=irradiance,
            direct=direct,
            valid=grid(dr.select(points.valid, mi.Float(1), 0)),
        )

    def mean_irradiance(self, name: str, sums: PassSums) -> np.ndarray:
        """Mean irradiance at a set of points, W/m², (N, 3); 0 at invalid points."""
        return self._mean(name, sums.points[name], sums.passes)

    def mean_direct(self, name: str, sums: PassSums) -> np.ndarray:
        """The part of the mean irradiance from samples of the emitters, W/m², (N, 3)."""
        return self._mean(name, sums.direct.get(name), sums.passes)

    def _mean(self, name: str, total: ExactSum | None, passes: int) -> np.ndarray:
        result = np.zeros((dr.width(self.points[name].p), 3), np.float32)
        if total is not None:
            lanes = np.asarray(self._valid[name].numpy())
            result[lanes] = total.total() / passes
        return result


def film_size(sensor: mi.Sensor) -> tuple[int, int]:
    """Width and height of a sensor's film, pixels."""
    size = sensor.film().crop_size()
    return int(size[0]), int(size[1])
