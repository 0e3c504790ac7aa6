"""Fitting a radiance volume to images."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from baselines.instant_ngp.occupancy_grid import OccupancyGrid
from baselines.instant_ngp.radiance_volume import RadianceVolume
from baselines.instant_ngp.ray_marching import (
    Rays,
    clip_rays,
    composite,
    composite_adjoint,
    take_samples,
)
from baselines.neural.fitting import Fit, Recorded, given, run_steps
from baselines.neural.hash_encoding import Cube
from gpf.core.random import step_random
from gpf.core.structs import from_numpy
from gpf.scene.pinhole import Pinhole
from gpf.training.settings import cosine_decay

# ε in the denominator of the loss, in units of display white. RawNeRF uses 1e-3, for photographs at
# night; with that, single dark pixels outweigh all others (after 500 steps, 15.7 instead of 17.6 dB
# on the training views of Water Caustic 2).
LOSS_FLOOR = 0.1

# Steps between updates of the occupancy grid.
UPDATE_STEPS = 16


@dataclass(frozen=True)
class VolumeTraining:
    """How the volume is fitted.

    Attributes
    ----------
    steps: optimiser steps.
    samples: samples per step, over all of its rays; the number of rays is adjusted to reach it.
    rate: Adam's initial rate; it decays to ``final_rate`` times that along a cosine.
    near: minimum distance of samples from the camera, in units of the cube's edge.
    seed: random seed.
    """

    steps: int
    samples: int = 1 << 17
    rate: float = 1e-2
    final_rate: float = 0.03
    near: float = 0.05
    seed: int = 0


@dataclass
class Cameras:
    """Pinhole cameras as arrays, (V): origins in the cube, and the vectors of ``corner + x right +
    y down``, the direction at (x, y) pixels from the image's upper left corner."""

    origin: mi.Point3f
    corner: mi.Vector3f
    right: mi.Vector3f
    down: mi.Vector3f

    @classmethod
    def gather(cls, cameras: Sequence[Pinhole], cube: Cube) -> Cameras:
        """The cameras of some views."""

        def columns(rows: list[np.ndarray]) -> np.ndarray:
            return np.ascontiguousarray(np.array(rows, dtype=np.float32).T)

        right, down, ahead = (
            [camera.rotation[:, k] / scale for camera in cameras for scale in [camera.focal]]
            for k in range(3)
        )
        corner = [
            a * c.focal - r * c.size[0] / 2 - d * c.size[1] / 2
            for c, r, d, a in zip(cameras, right, down, ahead, strict=True)
        ]
        origin = mi.Point3f(columns([camera.origin for camera in cameras]))
        return cls(
            cube.place(origin),
            mi.Vector3f(columns(corner)),
            mi.Vector3f(columns(right)),
            mi.Vector3f(columns(down)),
        )

    def look(self, camera: mi.UInt32, pixel: mi.Point2f) -> tuple[mi.Point3f, mi.Vector3f]:
        """Origins and unit directions of rays through pixel coordinates of cameras."""
        d = dr.gather(mi.Vector3f, self.corner, camera)
        d += pixel.x * dr.gather(mi.Vector3f, self.right, camera)
        d += pixel.y * dr.gather(mi.Vector3f, self.down, camera)
        return dr.gather(mi.Point3f, self.origin, camera), dr.normalize(d)


@dataclass(frozen=True)
class Box:
    """The rendered box in coordinates of the cube, and the minimum distance ``near`` of samples."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    near: float

    def clip(self, o: mi.Point3f, d: mi.Vector3f) -> Rays:
        """Clip rays to the rendered part."""
        rays = clip_rays(o, d, mi.Point3f(*self.lower), mi.Point3f(*self.upper))
        rays.near = dr.maximum(rays.near, self.near)
        return rays


class VolumeTrainer:
    """Fits a volume to the images of cameras.

    The loss is that of RawNeRF (Mildenhall and others 2022), a linearised tone mapping of HDR
    images: the mean of ((C - y) / (C + ε))², where the denominator is treated as constant.

    Parameters
    ----------
    images: (V, H, W, 3), linear, in the volume's unit.
    """

    def __init__(
        self,
        volume: RadianceVolume,
        grid: OccupancyGrid,
        box: Box,
        cameras: Cameras,
        images: np.ndarray,
        settings: VolumeTraining,
    ) -> None:
        self.volume, self.grid, self.box, self.settings = volume, grid, box, settings
        self.cameras, self.shape = cameras, images.shape[:3]
        self.pixels = from_numpy(mi.Color3f, images.reshape(-1, 3))
        self.fit = Fit(volume.parameters)
        self.rays = 1024  # in the next step
        self._answer = Recorded(self._trace_answer)
        self._gradients = Recorded(self._trace_gradients)

    def run(
        self,
        checkpoint: Path,
        fingerprint: Mapping[str, Any],
        report: Callable[[int, int], None] = lambda done, total: None,
    ) -> None:
        """Run all remaining steps; volume and grid hold the result.

        Continues from a checkpoint with the same fingerprint.
        """
        more = self.fit.restore(checkpoint, fingerprint)
        if more is not None:
            self.grid.density = from_numpy(mi.Float, more["density"])
            self.rays = int(more["rays"][0])
            self.grid.refresh()

        def save() -> None:
            kept = {"density": self.grid.density.numpy(), "rays": np.array([self.rays])}
            self.fit.save(checkpoint, fingerprint, kept)

        run_steps(self.fit, self.settings.steps, self.step, save, report)
        self.volume.update(self.fit.values)

    def step(self) -> float:
        """Run one optimiser step; returns the loss."""
        s, fit = self.settings, self.fit
        rays, target, first = self._choose_rays()
        samples = take_samples(self.grid, rays, first, s.samples)
        p, d = rays.at(samples.distance, samples.ray)
        density, colour = self._answer(fit.values, p, d)
        seen = composite(samples, density, colour, self.grid.length)
        dr.eval(seen)
        inverse = dr.rcp(seen.colour + LOSS_FLOOR)
        error = dr.select(samples.count > 0, (seen.colour - target) * inverse, 0)
        adjoint = 2 * error * inverse
        dr.eval(error, adjoint)
        chosen, *by_answer = composite_adjoint(
            samples, density, colour, self.grid.length, seen, adjoint
        )
        p, d = dr.gather(mi.Point3f, p, chosen), dr.gather(mi.Vector3f, d, chosen)
        dr.eval(p, d)
        gradients = self._gradients(fit.values, p, d, *by_answer)
        rate = dr.opaque(mi.Float, s.rate * cosine_decay(fit.step / s.steps, s.final_rate))
        rates = [rate] * len(fit.values)
        fit.values = fit.adam.step(fit.values, gradients, rates, fit.step + 1)
        dr.eval(fit.values, fit.adam.first, fit.adam.second)
        fit.step += 1
        filled = max(samples.total, 1) / s.samples
        self.rays = int(min(max(0.9 * self.rays / filled, self.rays / 2), 2 * self.rays, 1 << 18))
        if fit.step % UPDATE_STEPS == 0:
            self.volume.update(fit.values)
            self.grid.update(self.volume.density, s.seed, fit.step // UPDATE_STEPS)
        return float(dr.mean(dr.squared_norm(error))[0]) / 3

    def _choose_rays(self) -> tuple[Rays, mi.Color3f, mi.Float]:
        """Rays through random pixels, the pixels' colours, and the distances of first samples."""
        views, height, width = self.shape
        seed, number = dr.opaque(mi.UInt32, self.settings.seed), dr.opaque(mi.UInt32, self.fit.step)
        rng = step_random(self.rays, seed, number)
        count = dr.opaque(mi.UInt32, views * height * width)
        index = dr.mul_hi(rng.next_uint32(), count)
        columns = dr.opaque(mi.UInt32, width)
        row = index // columns
        camera = row // dr.opaque(mi.UInt32, height)
        corner = mi.Point2f(index - row * columns, row - camera * dr.opaque(mi.UInt32, height))
        pixel = corner + mi.Point2f(rng.next_float32(), rng.next_float32())
        rays = self.box.clip(*self.cameras.look(camera, pixel))
        first = rays.near + rng.next_float32() * self.grid.step
        target = dr.gather(mi.Color3f, self.pixels, index)
        dr.eval(rays, first, target)
        return rays, target, first

    def _trace_answer(
        self, values: list[mi.Float], p: mi.Point3f, d: mi.Vector3f
    ) -> tuple[mi.Float, mi.Color3f]:
        """Density and colour at places, along directions."""
        with given(self.volume, values):
            result = self.volume(p, d)
            dr.eval(result)
        return result

    def _trace_gradients(
        self,
        values: list[mi.Float],
        p: mi.Point3f,
        d: mi.Vector3f,
        by_density: mi.Float,
        by_colour: mi.Color3f,
    ) -> list[mi.Float]:
        """Gradients for all parameters, from those for density and colour."""
        values = [dr.detach(value) for value in values]  # leaves the caller's arrays unchanged
        dr.enable_grad(values)
        with given(self.volume, values):
            density, colour = self.volume(p, d)
        dr.backward(density * by_density + dr.dot(colour, by_colour))
        result = [dr.grad(value) for value in values]
        dr.eval(result)
        return result


def step_length(resolution: int) -> float:
    """Length of a ray's steps in units of the cube's edge: ``resolution`` steps per diagonal."""
    return math.sqrt(3) / resolution
