"""Reference images and targets: many passes of SPPM for several views from the same photons."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import drjit as dr
import mitsuba as mi
import numpy as np
from pydantic import Field

from gpf.camera.film import FilmSamples, sample_film
from gpf.core.random import Stream, pass_seed, random_start, stream_of
from gpf.core.settings import AutoCount, Count, Length, NotNegative, Positive, Seed
from gpf.core.structs import VisiblePoints, concatenate, take, to_numpy
from gpf.guiding.emission_plan import EmissionPlan
from gpf.photons.emission import Source, emit_light
from gpf.photons.tracing import PathSettings
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.pass_sums import ExactSum, PassSums
from gpf.sppm.passes import PassSettings, PhotonPasses, propose_radius

# With `photons_per_pass: auto`, a pass is as good as so many paths that bring equal power.
EQUAL_PATHS = 50_000


class ReferenceSettings(PassSettings):
    """Long sums of passes: references, and the targets of training.

    Attributes
    ----------
    passes: how many there are to be.
    photons_per_pass: emitted paths; ``auto``: by what they bring to the visible region.
    initial_radius: world units; ``auto``: from the photon density at the first view.
    view_points, surface_points: supervised points that views see, and on surfaces, at most.
    images: of training views beside their points; ``auto``: as many as some system learns from.
    checkpoint_seconds, preview_seconds: between files that show or keep what there is; 0: none.
    target_psnr: dB; fewer passes will do once a second reference would agree so well; 0: all.
    """

    passes: Annotated[int, Field(ge=4)] = 250
    photons_per_pass: AutoCount = "auto"  # type: ignore[assignment]
    initial_radius: Length = "auto"  # type: ignore[assignment]
    max_depth: Literal[-1] = -1  # fields and targets have light of any number of bounces
    view_points: Count = 200_000
    surface_points: Annotated[int, Field(ge=0)] = 300_000
    images: Annotated[int, Field(ge=0)] | Literal["auto"] = "auto"
    seed: Seed = 1
    checkpoint_seconds: Positive = 30.0
    preview_seconds: NotNegative = 10.0
    target_psnr: NotNegative = 0.0

    def measure(self, scene: mi.Scene, sensor: mi.Sensor, plan: EmissionPlan) -> PassSettings:
        """Settings of the passes; what is ``auto`` is measured.

        The number of paths by what they bring to the visible region, the radius at what the sensor
        sees.
        """
        paths, radius = self.photons_per_pass, self.initial_radius
        if paths == "auto":
            paths = plan.paths_for_passes(EQUAL_PATHS)
        if radius == "auto":
            film = sample_film(scene, sensor, pass_seed(self.seed, 0, Stream.CAMERA))
            pilot = PathSettings(paths, rr_depth=self.rr_depth, source=plan.source)
            measured = propose_radius(scene, film.points, pilot, self.seed)
            # In steps of a fifth: another training view is no reason to render novel views again.
            radius = float(f"{2 ** (round(4 * np.log2(measured)) / 4):.4g}")
        common = {name: getattr(self, name) for name in PassSettings.model_fields}
        return PassSettings(**common | {"photons_per_pass": paths, "initial_radius": radius})


@dataclass(frozen=True)
class ReferenceView:
    """What many passes tell about one view.

    Attributes
    ----------
    radiance: mean over passes, each with a new sample in every pixel, (H, W, 3); None for a view
        that has points alone.
    standard_error: of the radiance, from its variance between passes, (H, W, 3); None likewise.
    position, normal, reflectance: of one fixed visible point per pixel, (H, W, 3).
    irradiance: mean over passes at that point, (H, W, 3); None for a view that has an image alone.
    direct: how much of it came from samples of the emitters; 0 where photons brought all of it.
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
        """As layers of an EXR."""
        return {name: layer for name, layer in vars(self).items() if layer is not None}


class ReferenceRenderer:
    """Accumulates passes for a group of views that share their photons.

    A view's result depends on the seed, the settings and the view's own name and camera, not on
    which other views are in the group: photons of a pass are the same for all, and each view has
    its own camera samples.

    Parameters
    ----------
    sensors: one sensor per view whose image is accumulated, by name.
    points: fixed sets of points whose irradiance is accumulated, by name: the visible points of a
        view (:func:`fixed_points`), samples of the scene's surfaces.
    source: where photons start; see :func:`gpf.photons.tracing.trace_photons`.
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
        # Only valid points are gathered at: of many views they may be few.
        self._valid = {name: dr.compress(points.valid) for name, points in self.points.items()}
        dr.eval(self.points)
        self._join_points()
        self.sizes = {name: film_size(sensor) for name, sensor in self.sensors.items()}

    def _join_points(self) -> None:
        """Make one set of all: many small ones would each wait for their slowest point."""
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
        """Sums over no passes, of the right shape."""
        pixels = {name: width * height for name, (width, height) in self.sizes.items()}
        points = {name: dr.width(lanes) for name, lanes in self._valid.items()}
        return PassSums(pixels, points, apart=self.settings.direct == "emitters")

    def run(
        self,
        passes: int,
        sums: PassSums | None = None,
        tick: Callable[[int], None] = lambda done: None,
    ) -> PassSums:
        """Continue sums, or begin with none, until they are over passes 1 to ``passes``;
        ``tick(done)`` after each pass."""
        sums = sums or self.empty_sums()
        while sums.passes < passes:
            self.run_pass(sums.passes + 1, sums)
            tick(sums.passes)
        return sums

    def run_pass(self, t: int, sums: PassSums) -> None:
        """Add pass ``t`` (from 1) to sums."""
        photons = self.passes.trace(t)
        for name, sensor in self.sensors.items():
            film = sample_view(self.scene, sensor, name, self.settings, self.seed, t)
            dr.eval(film)
            radiance = film.points.radiance(photons.irradiance(film.points))
            sums.views[name].add(film.merge(radiance), t)
        if self._joined is not None:
            irradiance, direct = photons.all_irradiance(self._joined, self._start, t)
            dr.eval(irradiance)  # or each set's sum would search for all photons anew
            for name, lanes in self._lanes.items():
                sums.points[name].add(dr.gather(mi.Color3f, irradiance, lanes))
                if direct is not None:
                    sums.direct[name].add(dr.gather(mi.Color3f, direct, lanes))
        # Without waiting, passes pile up and the progress bar lies.
        dr.sync_thread()
        sums.passes += 1

    def image(self, name: str, sums: PassSums) -> np.ndarray:
        """Mean radiance of a view over the passes in the sums, (H, W, 3)."""
        return self._grid(name, sums.views[name].mean(sums.passes))

    def _grid(self, name: str, value: np.ndarray) -> np.ndarray:
        width, height = self.sizes[name]
        return value.reshape(height, width, 3).astype(np.float32)

    def view(self, name: str, sums: PassSums, size: tuple[int, int] | None = None) -> ReferenceView:
        """All that sums tell of a view: its image, and the fixed points that have its name.

        ``size`` is the width and height of its film, which a view with an image knows.
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
            normal=grid(points.n),
            reflectance=grid(points.reflectance),
            irradiance=irradiance,
            direct=direct,
            valid=grid(dr.select(points.valid, mi.Float(1), 0)),
        )

    def mean_irradiance(self, name: str, sums: PassSums) -> np.ndarray:
        """Mean irradiance at a set of points, (N, 3); 0 where a point is not valid."""
        return self._mean(name, sums.points[name], sums.passes)

    def mean_direct(self, name: str, sums: PassSums) -> np.ndarray:
        """The part of it that came from samples of the emitters, (N, 3)."""
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
    """One sample per pixel of a view, new for each pass ``t``."""
    return sample_film(
        scene,
        sensor,
        pass_seed(seed, t, stream_of(name)),
        settings.max_depth,
        settings.rr_depth,
        direct=settings.direct == "emitters",
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
    """One visible point per pixel that stays the same for all passes, (W H,).

    Only a ``share`` of the pixels, chosen at random, has a valid one.
    """
    # Direct light is theirs in each pass anew, not once and for all.
    whole = settings.model_copy(update={"direct": "photons", "glossy_walks": 1})
    points = sample_view(scene, sensor, name, whole, seed, t=0).points
    if share < 1:
        rng = np.random.default_rng(pass_seed(seed, 1, stream_of(name)))
        points.valid &= mi.Bool(rng.random(dr.width(points.p)) < share)
    return points


def film_size(sensor: mi.Sensor) -> tuple[int, int]:
    """Width and height of a sensor's film, pixels."""
    size = sensor.film().crop_size()
    return int(size[0]), int(size[1])
