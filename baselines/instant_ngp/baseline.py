"""Instant-NGP (Müller and others 2022): a radiance field from images.

As in the paper: a hash grid and small networks, rays that skip the empty cells of an occupancy
grid, steps of equal length, view dependence by spherical harmonics of order 3, and batches of as
many rays as fill a fixed number of samples. The networks are smaller than in the paper, because a
CPU trains them.

The images are HDR, so colour is linear without an upper bound. The loss is RawNeRF's (Mildenhall
and others 2022), squared differences relative to the current estimate: a linearised logarithmic
tone mapping.

The volume is the scene's bounding box with a margin; cameras may be anywhere. Everything outside is
black. Left out: a model of the environment, lens effects, and refinement of the camera poses, which
are exact here.
"""

from __future__ import annotations

from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from baselines.instant_ngp.occupancy_grid import OccupancyGrid
from baselines.instant_ngp.radiance_volume import RadianceVolume, VolumeShape
from baselines.instant_ngp.ray_marching import Rays, next_distance
from baselines.instant_ngp.volume_training import (
    Box,
    Cameras,
    VolumeTrainer,
    VolumeTraining,
    step_length,
)
from baselines.neural.fitting import digest
from baselines.neural.hash_encoding import Cube, GridShape
from baselines.options import InstantNgpOptions
from baselines.protocol import CannotServe, Task, TrainingView
from gpf.core.images import tone_map
from gpf.core.random import Stream, pass_seed
from gpf.rendering.sample_sets import tile_order
from gpf.scene.bounds import bounding_box
from gpf.scene.pinhole import make_pinhole
from gpf.scene.views import View

SHAPE = VolumeShape(GridShape(8, 2, log2_entries=17, coarsest=16, finest=512))

# Cells of the occupancy grid along the cube's edge, and steps of a ray along its diagonal.
CELLS = 128
STEPS = 512

# Margin of the volume on each side, as a share of the scene's largest extent.
MARGIN = 0.05

# Rays per pixel of a rendered image, at random places in the pixel.
RAYS = 4

# A ray of a rendered image ends below this transmittance.
FAINT = 1e-3


class InstantNgp:
    """The system ``instant_ngp``."""

    def __init__(self, options: InstantNgpOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedVolume:
        """Fit the volume to the training views.

        Raises
        ------
        CannotServe: there are no training views.
        """
        if not task.training:
            raise CannotServe(
                f"scene {task.name}", "has no training views", "List some under views: train."
            )
        options = self.options
        settings = VolumeTraining(steps=options.steps, samples=options.samples, seed=task.seed)
        scene_box = bounding_box(task.scene)
        cube = Cube.around(scene_box, MARGIN)
        box = _box_in(cube, scene_box, settings.near)
        volume = RadianceVolume(SHAPE, 1 / task.exposure, task.seed)
        grid = OccupancyGrid(CELLS, step_length(STEPS))
        pinholes = [make_pinhole(view.view, task.size) for view in task.training]
        grid.hide_unseen(pinholes, cube, settings.near)
        images = np.stack([view.radiance for view in task.training])
        trainer = VolumeTrainer(
            volume,
            grid,
            box,
            Cameras.gather(pinholes, cube),
            images * task.exposure,
            settings,
        )
        fingerprint = {
            "options": options.model_dump(mode="json"),
            "seed": task.seed,
            "views": [view.view.model_dump(mode="json") for view in task.training],
            "images": digest(images),
        }
        trainer.run(task.state / "instant_ngp.safetensors", fingerprint, task.report)
        return PreparedVolume(task, options.steps, volume, grid, box, cube)


def _box_in(cube: Cube, box: np.ndarray, near: float) -> Box:
    """A box (2, 3) of the world with its margin, in coordinates of the cube."""
    grown = box + np.array([[-1], [1]]) * MARGIN * (box[1] - box[0]).max()
    lower, upper = (grown - np.array(cube.corner)) / cube.edge
    return Box(tuple(lower.tolist()), tuple(upper.tolist()), near)


class PreparedVolume:
    """A fitted volume."""

    def __init__(
        self,
        task: Task,
        steps: int,
        volume: RadianceVolume,
        grid: OccupancyGrid,
        box: Box,
        cube: Cube,
    ) -> None:
        self._task, self._size, self._steps = task, task.size, steps
        self._volume, self._grid, self._box, self._cube = volume, grid, box, cube

    @property
    def storage_bytes(self) -> int:
        """All parameters, float32, and one bit per cell of the occupancy grid."""
        numbers = sum(dr.width(values) for values in self._volume.parameters)
        return 4 * numbers + self._grid.resolution**3 // 8

    @property
    def facts(self) -> Mapping[str, float | str]:
        """Steps, parameters, the share of occupied cells, and the mean PSNR of the training views,
        dB."""
        return {
            "steps": self._steps,
            "parameters": sum(dr.width(values) for values in self._volume.parameters),
            "occupied": self._grid.share,
            "training_psnr": float(np.mean([self._compare(k) for k in self._task.training])),
            "loss": "RawNeRF",
        }

    def _compare(self, seen: TrainingView) -> float:
        """PSNR of a tone-mapped training view, dB."""
        exposure = self._task.exposure
        image = self.render(seen.view, self._task.seed)
        error = np.mean((tone_map(image, exposure) - tone_map(seen.radiance, exposure)) ** 2)
        return float(-10 * np.log10(max(error, 1e-10)))

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32."""
        width, height = self._size
        cameras = Cameras.gather([make_pinhole(view, self._size)], self._cube)
        index = tile_order(width, height)
        order = index.numpy()
        row = index // dr.opaque(mi.UInt32, width)
        corner = mi.Point2f(index - row * dr.opaque(mi.UInt32, width), row)
        total = np.zeros((height * width, 3))
        for k in range(RAYS):
            rng = mi.PCG32(len(order), dr.opaque(mi.UInt64, pass_seed(seed, k, Stream.NGP_CAMERA)))
            pixel = corner + mi.Point2f(rng.next_float32(), rng.next_float32())
            rays = self._box.clip(*cameras.look(dr.zeros(mi.UInt32, len(order)), pixel))
            first = rays.near + rng.next_float32() * self._grid.length
            dr.eval(rays, first)
            colour = see(self._volume, self._grid, rays, first)
            total[order] += colour.numpy().T
        image = total * (self._volume.unit / RAYS)
        return image.reshape(height, width, 3).astype(np.float32)


@dr.syntax
def see(volume: RadianceVolume, grid: OccupancyGrid, rays: Rays, first: mi.Float) -> mi.Color3f:
    """Radiance of rays in the volume's unit, (R, 3): marching and compositing in one kernel."""
    t = mi.Float(first)
    total = mi.Color3f(0)
    through = mi.Float(1)
    while (t < rays.far) & (through > FAINT):
        active = (t < rays.far) & (through > FAINT)
        after, occupied = next_distance(grid, rays, t, active)
        if active & occupied:
            density, colour = volume(rays.o + t * rays.d, rays.d)
            kept = dr.exp(-density * grid.length)
            total += through * (1 - kept) * colour
            through *= kept
        t = after
    return total
