"""A plane whose irradiance is known, and trainers that fit a field to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.training.kernels import parameters
from gpf.training.settings import LearningRates, TrainingSettings
from gpf.training.trainer import Progress, Trainer
from tests.plain_field import ask, make_field, random_gaussians, surface_points

UP = np.array([0.0, 0.0, 1.0])
SETTINGS = TrainingSettings(
    steps=60,
    batch=512,
    rates=LearningRates(means=2e-3, log_scales=5e-3, quats=5e-3, irradiance=2e-2),
    rebuild_every=20,
    evaluate_every=10,
    held_out=0.2,
    loss="squared",
    seed=5,
)


def settings_with(**changes: object) -> TrainingSettings:
    return SETTINGS.model_copy(update=changes)


def irradiance_at(x: np.ndarray) -> np.ndarray:
    """Smooth, and other in each channel and along each axis."""
    a, b = x[:, 0], x[:, 1]
    return np.column_stack([2 + np.sin(3 * a), 1 + b**2, 3 - 0.5 * a * b])


def on_the_plane(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.column_stack([rng.uniform([-1, 0], [2, 2], (count, 2)), np.zeros(count)])


def make_points(count: int = 2000, scale: float = 1.0):
    x = on_the_plane(np.random.default_rng(1), count)
    return surface_points(x, np.tile(UP, (count, 1)), scale * irradiance_at(x))


def make_trainer(
    settings: TrainingSettings = SETTINGS,
    scale: float = 1.0,
    points=None,
    isotropic: bool = False,
    **options: bool,
) -> Trainer:
    rng = np.random.default_rng(2)
    g = random_gaussians(rng, 250, sizes=(0.1, 0.2))
    g = replace(
        g,
        means=on_the_plane(rng, 250).astype(np.float32),
        normals=np.tile(UP, (250, 1)),
        irradiance=scale * g.irradiance,
        log_scales=np.full((250, 3), np.log(0.15)) if isotropic else g.log_scales,
    )
    field = make_field(g, FieldSettings(search_radius=0.3, k=3))
    options = {"from_targets": False} | options
    return Trainer(field, points or make_points(scale=scale), settings, **options)


def run(trainer: Trainer) -> tuple[GaussianPhotonField, list[Progress]]:
    reports = [progress for progress in trainer.steps() if progress]
    return trainer.finish(), reports


def error_of(field: GaussianPhotonField, scale: float = 1.0) -> float:
    """Root mean square error at new points, in units of the mean irradiance."""
    x = on_the_plane(np.random.default_rng(3), 1500)
    value, _ = ask(field, x, np.tile(UP, (1500, 1)))
    expected = scale * irradiance_at(x)
    return float(np.sqrt(np.mean((value - expected) ** 2)) / expected.mean())


def arrays_of(field: GaussianPhotonField) -> np.ndarray:
    return np.array([np.array(v) for v in parameters(field.gaussians)])
