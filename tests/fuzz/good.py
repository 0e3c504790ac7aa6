"""Good files that cases begin with: a scene with two lamps, its field, its cameras, its mesh."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np

from gpf.core.structs import to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.io import read_field, save_field, write_field
from gpf.field.lights import FieldLights
from gpf.field.settings import FieldSettings
from gpf.scene.bounds import scene_bounds
from gpf.scene.fingerprint import fingerprint
from gpf.scene.light_groups import LightGroups
from gpf.scene.load import load_scene_file
from tests.fuzz.texts import SCENE, TRANSFORMS, VIEWS
from tests.plain_field import flat_gaussians, to_device


def make_good_files(folder: Path) -> None:
    """Write them, each kind of field once; whole when the folder exists."""
    work = folder.with_name(f"{folder.name}-{os.getpid()}")
    work.mkdir(parents=True)
    (work / "scene.xml").write_text(SCENE)
    (work / "views.yaml").write_text(VIEWS)
    (work / "transforms.json").write_text(json.dumps(TRANSFORMS))
    scene = load_scene_file(work / "scene.xml")
    save_field(make_field(scene), work / "field.safetensors")
    save_field(make_field(scene), work / "compact.safetensors", "compact")
    stored = read_field(work / "field.safetensors")
    table = np.zeros((2, 1, 3), np.uint8)
    table[1] = 1
    levels = (stored.tensors["means"][:, 0] > 0).astype(np.uint8)
    tensors = {**stored.tensors, "levels": levels, "detail": table}
    grid = {"width": 3.0, "corner": [-3.0, -0.5, -3.0]}
    write_field(replace(stored, tensors=tensors, grid=grid), work / "levels.safetensors")
    work.rename(folder)


def make_field(scene: mi.Scene, count: int = 200) -> GaussianPhotonField:
    """Gaussians on the floor, with the light of two groups."""
    rng = np.random.default_rng(0)
    points = np.zeros((count, 3), np.float32)
    points[:, [0, 2]] = rng.uniform(-3, 3, (count, 2))
    gaussians = to_device(flat_gaussians(points, np.ones((count, 3)), size=0.3))
    field = GaussianPhotonField(
        gaussians,
        FieldSettings(search_radius=0.8),
        scene_bounds(scene),
        {"fingerprint": fingerprint(scene), "exposure": 1.0},
    )
    light = to_numpy(gaussians.irradiance)
    groups = LightGroups(("lamp", "sky"), ((0,), (1,)))
    field.lights = FieldLights(groups, np.stack([0.25 * light, 0.75 * light]).astype(np.float32))
    field.set_error(np.full(count, 0.05, np.float32))
    return field
