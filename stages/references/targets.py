"""Makes the training targets from what the references have measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.files import write_tensors
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import VisiblePoints, from_numpy
from gpf.scene.lamps import Lamps
from gpf.sppm.fixed_points import FixedPoints
from gpf.training.targets import SURFACES, Targets, source_numbers


def targets_of_view(layers: Mapping[str, np.ndarray], number: int) -> Targets:
    """Targets of view ``number``, from the layers of its reference, in image order."""
    valid = layers["valid"] > 0.5
    names = ("position", "normal", "irradiance", "direct", "reflectance")
    source = np.full(int(valid.sum()), number, np.int32)
    return Targets(**{name: layers[name][valid] for name in names}, source=source)


def targets_of_surfaces(tensors: Mapping[str, np.ndarray]) -> Targets:
    """Targets at samples of the scene's surfaces."""
    ones = np.ones_like(tensors["position"])
    source = np.repeat(source_numbers([SURFACES]), len(ones))
    names = ("position", "normal", "irradiance", "direct")
    return Targets(**{name: tensors[name] for name in names}, reflectance=ones, source=source)


def join(parts: Sequence[Targets]) -> Targets:
    """All parts, in order."""
    names = [f.name for f in fields(Targets)]
    return Targets(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names})


def save(targets: Targets, path: Path, scene: str | None = None) -> None:
    """Write targets, and the name of their scene if it has one."""
    facts = {} if scene is None else {"scene": scene}
    write_tensors(path, "targets", {**vars(targets)}, facts)


def without_direct(
    targets: Targets, scene: mi.Scene, lamps: Lamps, seed: int, samples: int = 16
) -> Targets:
    """The targets without the direct light of some lamps, which is sampled at each point.

    Samples are noisy, so some targets may be negative; with these cut off at zero, the mean would
    be too bright.
    """
    points = dr.zeros(VisiblePoints, len(targets.position))
    points.p = from_numpy(mi.Point3f, targets.position)
    points.n = from_numpy(mi.Normal3f, targets.normal)
    seed = pass_seed(seed, 0, Stream.STREAM_EMITTERS)
    direct = FixedPoints(scene, points).mean_direct(lamps, samples, seed)
    return replace(targets, irradiance=targets.irradiance - direct)
