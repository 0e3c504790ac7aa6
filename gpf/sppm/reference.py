"""Reference images and training targets: many passes of SPPM; several views share the photons."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import drjit as dr
import mitsuba as mi
import numpy as np
from pydantic import Field

from gpf.camera.film import FilmSamples, sample_film
from gpf.core.random import Stream, pass_seed, random_start, stream_of
from gpf.core.settings import AutoCount, Count, Length, NotNegative, Seed
from gpf.core.structs import VisiblePoints, concatenate, from_numpy, take, to_numpy
from gpf.guiding.emission_plan import EmissionPlan
from gpf.guiding.visible_region import sample_visible_points
from gpf.photons.emission import Source, emit_light
from gpf.photons.tracing import PathSettings
from gpf.scene.lamps import Lamps
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.pass_sums import ExactSum, PassSums
from gpf.sppm.passes import PassSettings, PhotonPasses, propose_radius

# With `photons_per_pass: auto`, a pass is as good as this many photon paths of equal power.
EQUAL_PATHS = 50_000

# With `initial_radius: auto`, the radius is measured at this many points that the views see.
RADIUS_POINTS = 65_536


class ReferenceSettings(PassSettings):
    """Settings of the references and of the training targets.

    Attributes
    ----------
    passes: maximum number of passes.
    photons_per_pass: emitted paths; ``auto``: depends on what they contribute to the visible
        region.
    initial_radius: world units; ``auto``: from the photon density where the views look.
    view_points, surface_points: maximum number of supervised points seen by training views, and of
        supervised surface samples.
    images: number of training views with images; ``auto``: as many as the systems to be run need.
    target_psnr: dB; stop when a second reference is expected to agree this well; 0: never.
    """

    passes: Annotated[int, Field(ge=4)] = 250
    photons_per_pass: AutoCount = "auto"  # type: ignore[assignment]
    initial_radius: Length = "auto"  # type: ignore[assignment]
    max_depth: Literal[-1] = -1  # fields and targets hold light after any number of bounces
    view_points: Count = 200_000
    surface_points: Annotated[int, Field(ge=0)] = 300_000
    images: Annotated[int, Field(ge=0)] | Literal["auto"] = "auto"
    seed: Seed = 1
    target_psnr: NotNegative = 0.0

    def measure(
        self, scene: mi.Scene, sensors: Sequence[mi.Sensor], plan: EmissionPlan
    ) -> PassSettings:
        """Settings of the passes, with measured values in place of ``auto``: the number of paths
        depends on what they contribute to the visible region, the radius on the points that all
        sensors see.
        """
        paths, radius = self.photons_per_pass, self.initial_radius
        if paths == "auto":
            paths = plan.paths_for_passes(EQUAL_PATHS)
        if radius == "auto":
            each, seed = (
                max(1, RADIUS_POINTS // len(sensors)),
                pass_seed(self.seed, 0, Stream.CAMERA),
            )
            seen = [sample_visible_points(scene, sensor, each, seed, 0) for sensor in sensors]
            pilot = PathSettings(paths, rr_depth=self.rr_depth, source=plan.source)
            measured = propose_radius(scene, concatenate(seen), pilot, self.seed)
            # Rounded in steps of a fifth, so that a new training view rarely changes the radius:
            # with a different radius, all novel views would have to be rendered again.
            radius = float(f"{2 ** (round(4 * np.log2(measured)) / 4):.4g}")
        common = {name: getattr(self, name) for name in PassSettings.model_fields}
        return PassSettings(**common | {"photons_per_pass": paths, "initial_radius": radius})


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


def sample_view(
    scene: mi.Scene, sensor: mi.Sensor, name: str, settings: PassSettings, seed: int, t: int
) -> FilmSamples:
    """One sample per pixel of a view; each pass ``t`` has different samples."""
    return sample_film(
        scene,
        sensor,
        pass_seed(seed, t, stream_of(name)),
        settings.max_depth,
        settings.rr_depth,
        lamps=Lamps(scene) if settings.direct == "emitters" else None,
        walks=settings.glossy_walks,
    )


def fixed_points(
    scene: mi.Scene,
    sensor: mi.Sensor,
    name: str,
    settings: PassSettings,
    seed: int,
    share: float = 1.0,
) -> VisiblePoints:
    """One visible point per pixel, the same for all passes, (W H,).

    Only a random ``share`` of the pixels have a valid point.
    """
    # Direct light at these points is sampled in each pass, not here.
    whole = settings.model_copy(update={"direct": "photons", "glossy_walks": 1})
    points = sample_view(scene, sensor, name, whole, seed, t=0).points
    if share < 1:
        rng = np.random.default_rng(pass_seed(seed, 1, stream_of(name)))
        points.valid &= from_numpy(mi.Bool, rng.random(dr.width(points.p)) < share)
    return points


def film_size(sensor: mi.Sensor) -> tuple[int, int]:
    """Width and height of a sensor's film, pixels."""
    size = sensor.film().crop_size()
    return int(size[0]), int(size[1])
