"""Reference images and targets: many passes of SPPM for several views from the same photons."""

from __future__ import annotations

import json
import time
import zlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.artifacts import read_tensors, write_tensors
from gpf.progressive import PassSettings, gather_pass, pass_seed, sample_film
from gpf.structs import VisiblePoints, concatenate, to_numpy


@dataclass(frozen=True)
class ReferenceView:
    """What many passes tell about one view.

    Attributes
    ----------
    radiance: mean over passes, each with a new sample in every pixel, (H, W, 3).
    position, normal, reflectance: of one fixed visible point per pixel, (H, W, 3).
    irradiance: mean over passes at that point, (H, W, 3).
    valid: 1 where the pixel has a visible point, else 0, (H, W).
    """

    radiance: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    reflectance: np.ndarray
    irradiance: np.ndarray
    valid: np.ndarray

    def layers(self) -> dict[str, np.ndarray]:
        """As layers of an EXR."""
        return dict(vars(self))


class ReferenceRenderer:
    """Accumulates passes for a group of views that share their photons.

    A view's result depends on the seed, the settings and the view's own name and camera, not on
    which other views are in the group: photons of a pass are the same for all, and each view has
    its own camera samples.

    Parameters
    ----------
    sensors: one sensor per view, by name.
    extra: further fixed points that are gathered at, e.g. samples of the scene's surfaces.
    fixed: whether to gather at one fixed point per pixel too.
    """

    def __init__(
        self,
        scene: mi.Scene,
        sensors: Mapping[str, mi.Sensor],
        settings: PassSettings,
        seed: int,
        extra: VisiblePoints | None = None,
        fixed: bool = True,
    ) -> None:
        self.scene, self.sensors, self.settings, self.seed = scene, dict(sensors), settings, seed
        self.passes_done = 0
        self.sizes = {name: _film_size(sensor) for name, sensor in self.sensors.items()}
        self.fixed: list[VisiblePoints] = []
        if fixed:
            self.fixed = [self._sample(name, t=0).points for name in self.sensors]
        if extra is not None:
            self.fixed.append(extra)
        for points in self.fixed:
            dr.eval(points)
        self.radiance = {n: dr.zeros(mi.Color3f, w * h) for n, (w, h) in self.sizes.items()}
        self.irradiance = [dr.zeros(mi.Color3f, dr.width(points.p)) for points in self.fixed]

    def _sample(self, name: str, t: int) -> Any:
        """One film sample per pixel of a view, new for each pass."""
        width, height = self.sizes[name]
        sampler = mi.load_dict({"type": "independent", "sample_count": 1})
        sampler.seed(pass_seed(self.seed, t, zlib.crc32(name.encode())), width * height)
        s = self.settings
        return sample_film(self.scene, self.sensors[name], sampler, s.max_depth, s.rr_depth)

    def run(self, passes: int, tick: Callable[[int], None] = lambda done: None) -> None:
        """Continue until ``passes`` passes are done; ``tick(done)`` after each."""
        while self.passes_done < passes:
            self.run_pass()
            tick(self.passes_done)

    def run_pass(self) -> None:
        """Add one pass."""
        t = self.passes_done + 1
        moving = [self._sample(name, t).points for name in self.sensors]
        for points in moving:
            dr.eval(points)
        parts = moving + self.fixed
        irradiance = gather_pass(self.scene, concatenate(parts), t, self.settings, self.seed)
        first = 0
        for k, points in enumerate(parts):
            size = dr.width(points.p)
            lanes = dr.arange(mi.UInt32, size) + dr.opaque(mi.UInt32, first)
            value = dr.gather(mi.Color3f, irradiance, lanes)
            first += size
            if k < len(moving):
                name = list(self.sensors)[k]
                self.radiance[name] += points.radiance(value)
            else:
                self.irradiance[k - len(moving)] += value
        dr.eval(self.radiance, self.irradiance)
        # Without waiting, passes pile up and the progress bar lies.
        dr.sync_thread()
        self.passes_done = t

    def image(self, name: str) -> np.ndarray:
        """Mean radiance of a view so far, (H, W, 3)."""
        width, height = self.sizes[name]
        return to_numpy(self.radiance[name]).reshape(height, width, 3) / self.passes_done

    def view(self, name: str) -> ReferenceView:
        """All that is known of a view so far; needs the fixed points."""
        width, height = self.sizes[name]
        k = list(self.sensors).index(name)
        points = self.fixed[k]

        def grid(value: Any) -> np.ndarray:
            return to_numpy(value).reshape(height, width, -1).squeeze()

        return ReferenceView(
            radiance=self.image(name),
            position=grid(points.p),
            normal=grid(points.n),
            reflectance=grid(points.reflectance),
            irradiance=grid(self.irradiance[k]) / self.passes_done,
            valid=grid(mi.Float(dr.select(points.valid, mi.Float(1), 0))),
        )

    def extra_irradiance(self) -> np.ndarray:
        """Mean irradiance at the extra points so far, (S, 3)."""
        return to_numpy(self.irradiance[-1]) / self.passes_done

    def save(self, path: Path, fingerprint: Mapping[str, Any], note: Any = None) -> None:
        """Write a checkpoint, atomically; ``note`` is kept for the one who restores it."""
        tensors = {f"radiance/{n}": to_numpy(v) for n, v in self.radiance.items()}
        tensors |= {f"irradiance/{k}": to_numpy(v) for k, v in enumerate(self.irradiance)}
        metadata = {"done": self.passes_done, "note": note, "fingerprint": dict(fingerprint)}
        write_tensors(path, "checkpoint", tensors, metadata)

    def restore(self, path: Path, fingerprint: Mapping[str, Any]) -> Any:
        """Continue from a checkpoint if there is one that the same parameters made.

        Returns its note, or None where there is no such checkpoint.
        """
        if not path.exists():
            return None
        tensors, metadata = read_tensors(path, "checkpoint", "reference")
        if metadata["fingerprint"] != json.loads(json.dumps(fingerprint)):
            return None
        for name in self.radiance:
            self.radiance[name] = mi.Color3f(np.ascontiguousarray(tensors[f"radiance/{name}"].T))
        for k in range(len(self.irradiance)):
            value = np.ascontiguousarray(tensors[f"irradiance/{k}"].T)
            self.irradiance[k] = mi.Color3f(value)
        self.passes_done = metadata["done"]
        return metadata["note"]


def time_single_view_pass(
    scene: mi.Scene, sensor: mi.Sensor, settings: PassSettings, seed: int, passes: int = 8
) -> float:
    """Seconds that one pass takes for somebody who renders a single view; median, compiled."""
    renderer = ReferenceRenderer(scene, {"timed": sensor}, settings, seed, fixed=False)
    seconds = []
    for _ in range(passes + 2):
        start = time.perf_counter()
        renderer.run_pass()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds[2:]))


def settings_record(settings: PassSettings, seed: int) -> dict[str, Any]:
    """The settings as JSON values."""
    return {**asdict(settings), "seed": seed}


def _film_size(sensor: mi.Sensor) -> tuple[int, int]:
    size = sensor.film().crop_size()
    return int(size[0]), int(size[1])
