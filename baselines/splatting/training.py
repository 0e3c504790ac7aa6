"""Fitting Gaussians to images, with 3DGS's loss and gsplat's strategy for their number."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from baselines.splatting.gsplat import import_gsplat
from baselines.splatting.image_loss import ImageLoss
from baselines.splatting.model import SplatModel
from baselines.splatting.rasteriser import Rasteriser
from gpf.core.errors import UserError
from gpf.core.files import read_tensors, write_tensors
from gpf.core.random import Stream, pass_seed
from gpf.scene.pinhole import Pinhole

# A training run is divided into this many parts. After each part from the second on, up to the
# fraction LAST_REFINEMENT of the run, the strategy splits, doubles and removes Gaussians.
REFINEMENTS = 30
LAST_REFINEMENT = 0.6
# Gaussians whose centres have a larger gradient than this (unit: half an image) are split or
# doubled. 3DGS uses 2e-4; with ten views, and images refracted by water, more Gaussians fit the
# training views better and the novel views worse.
PULL = 1e-3
# The highest degree of the harmonics rises by one after each such fraction of the run.
DEGREE_STEP = 0.1
CHECKPOINT_SECONDS = 30


@dataclass(frozen=True)
class Picture:
    """A camera and its image, sRGB in [0, 1], (H, W, 3)."""

    camera: Pinhole
    image: np.ndarray


@dataclass(frozen=True)
class Plan:
    """Settings of a training run.

    Attributes
    ----------
    steps: optimiser steps, each on one image.
    most: approximate upper limit of the Gaussians. If the strategy asks for more, only Gaussians
        with the largest gradients are split or doubled.
    degree: highest degree of the harmonics.
    seed: random seed of the order of images and the places of split Gaussians.
    """

    steps: int
    most: int
    degree: int
    seed: int


class SplatTrainer:
    """A training run that can continue from a checkpoint."""

    def __init__(
        self, model: SplatModel, pictures: Sequence[Picture], rasteriser: Rasteriser, plan: Plan
    ) -> None:
        self.model, self.plan, self.rasteriser = model, plan, rasteriser
        self.pictures = tuple(pictures)
        self.losses = [ImageLoss(picture.image) for picture in pictures]
        every = max(plan.steps // REFINEMENTS, 1)
        self.strategy = import_gsplat().DefaultStrategy(
            grow_grad2d=PULL,
            refine_start_iter=every,
            refine_stop_iter=int(LAST_REFINEMENT * plan.steps),
            refine_every=every,
            reset_every=plan.steps + 1,  # never: resets suit runs ten times as long
        )
        self.state = self.strategy.initialize_state(scene_scale=model.size)
        self.done = 0

    def run(self, file: Path, report: Callable[[int, int], None]) -> None:
        """Run the remaining steps; write the checkpoint ``file`` now and then and at the end."""
        saved = time.monotonic()
        with _one_thread():
            while self.done < self.plan.steps:
                self.step()
                report(self.done, self.plan.steps)
                if time.monotonic() - saved > CHECKPOINT_SECONDS:
                    self.save(file)
                    saved = time.monotonic()
        self.save(file)

    def step(self) -> float:
        """Run one optimiser step on one image; returns its loss before the step."""
        plan, step = self.plan, self.done
        k = self._next_picture(step)
        degree = min(plan.degree, int(step / (DEGREE_STEP * plan.steps)))
        drawing = self.rasteriser.draw(self.model.params, self.pictures[k].camera, degree)
        difference = self.losses[k](drawing.image)
        drawing.backward(difference.gradient)
        self.model.update(step / plan.steps)
        self._refine(step, drawing.info)
        self.done += 1
        return float(difference.loss[0])

    def _next_picture(self, step: int) -> int:
        """The index of the step's image: all images once in random order, then again."""
        count = len(self.pictures)
        rng = np.random.default_rng(pass_seed(self.plan.seed, step // count, Stream.SPLAT_VIEWS))
        return int(rng.permutation(count)[step % count])

    def _refine(self, step: int, info: dict[str, Any]) -> None:
        """Let the strategy split, double and remove Gaussians."""
        self.strategy.grow_grad2d = self._least_pull()
        with torch.random.fork_rng():
            torch.manual_seed(pass_seed(self.plan.seed, step, Stream.SPLAT_GROWTH))
            self.strategy.step_post_backward(
                self.model.params, self.model.optimizers, self.state, step, info
            )

    def _least_pull(self) -> float:
        """The least gradient for a split or doubling that keeps to about ``most`` Gaussians."""
        room = self.plan.most - self.model.count
        if room <= 0:
            return float("inf")
        if self.state["grad2d"] is None or room >= self.model.count:
            return PULL
        pulls = self.state["grad2d"] / self.state["count"].clamp_min(1)
        return max(PULL, float(pulls.kthvalue(self.model.count - room).values))

    def save(self, file: Path) -> None:
        """Write a checkpoint, atomically."""
        counters = {name: value for name, value in self.state.items() if torch.is_tensor(value)}
        arrays = {f"state.{name}": value.cpu().numpy() for name, value in counters.items()}
        record = {"done": self.done, "size": self.model.size}
        write_tensors(file, "splats", arrays | self.model.save(), record)

    @classmethod
    def resume(
        cls, file: Path, pictures: Sequence[Picture], rasteriser: Rasteriser, plan: Plan
    ) -> SplatTrainer | None:
        """The training run of a checkpoint, or None if there is no readable one."""
        try:
            arrays, record = read_tensors(file, "splats")
        except UserError:
            return None
        model = SplatModel.restore(arrays, record["size"], rasteriser.device)
        trainer = cls(model, pictures, rasteriser, plan)
        for name, array in arrays.items():
            if name.startswith("state."):
                value = torch.from_numpy(array).to(rasteriser.device)
                trainer.state[name.removeprefix("state.")] = value
        trainer.done = record["done"]
        return trainer


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limit torch to one thread: its work here is so small that more threads are slower."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
