"""What the tests of splatting share: Gaussians and a camera, a painted wall and its pictures."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import torch

from baselines.protocol import Task, TrainingView
from gpf.scene.pinhole import Pinhole, make_pinhole
from gpf.scene.views import View
from tests.baselines.adapters import make_task

SIZE = (20, 12)
PICTURE_SIZE = (32, 24)
INDEX = 1.5


def place_camera(size: tuple[int, int] = SIZE) -> Pinhole:
    """A camera before the origin, tilted."""
    view = View(name="a", origin=(0.3, 0.4, 4), target=(0.1, 0, 0), up=(0.1, 1, 0), fov=30)
    return make_pinhole(view, size)


def random_splats(count: int, degree: int) -> dict[str, torch.nn.Parameter]:
    """Gaussians around the origin, of all shapes."""
    rng = np.random.default_rng(0)
    arrays = {
        "means": rng.uniform(-1, 1, (count, 3)) * (1, 0.6, 1),
        "scales": np.log(0.12) + 0.5 * rng.normal(size=(count, 3)),
        "quats": rng.normal(size=(count, 4)),
        "opacities": rng.normal(size=count),
        "sh0": rng.normal(size=(count, 1, 3)),
        "shN": 0.3 * rng.normal(size=(count, (degree + 1) ** 2 - 1, 3)),
    }
    return {
        name: torch.nn.Parameter(torch.tensor(value, dtype=torch.float32))
        for name, value in arrays.items()
    }


def load_wall(water: bool) -> mi.Scene:
    """A wall at z = -1; with water, all behind z = 0 has an index of refraction of INDEX."""
    turn = mi.ScalarTransform4f()
    scene = {
        "type": "scene",
        "wall": {"type": "rectangle", "to_world": turn.translate([0, 0, -1]).scale(9)},
    }
    if water:
        glass = {"type": "dielectric", "int_ior": INDEX, "ext_ior": 1.0}
        scene["sheet"] = {"type": "rectangle", "to_world": turn.scale(9), "bsdf": glass}
    return mi.load_dict(scene)


def place_view(x: float, y: float) -> View:
    """A view of the wall from z = 3."""
    return View(name="a", origin=(x, y, 3), target=(0.3 * x, 0.1, -0.7), fov=30)


def photograph(view: View, water: bool) -> TrainingView:
    """What the view sees of the painted wall; no light is lost at the water."""
    camera = make_pinhole(view, PICTURE_SIZE)
    width, height = PICTURE_SIZE
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    d = np.stack([x, y, np.full(x.shape, camera.focal)], axis=-1) @ camera.rotation.T
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    entry = camera.origin - d * (camera.origin[2] / d[..., 2:])
    across = d[..., :2] / (INDEX if water else 1)
    down = np.sqrt(1 - (across**2).sum(axis=-1, keepdims=True))
    hit = entry[..., :2] + across / down
    return TrainingView(view, {"radiance": paint(*np.moveaxis(hit, -1, 0)).astype(np.float32)})


def paint(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The wall's radiance, (..., 3); within [0, 1] at the exposure of one half."""
    red, green = np.sin(4 * x + 2 * y), np.cos(5 * x) * np.sin(6 * y)
    return 1 + 0.8 * np.stack([red, green, np.sin(3 * x - 7 * y)], axis=-1)


def wall_task(state: Path, water: bool, places: list[tuple[float, float]]) -> Task:
    """Pictures of the wall from some places."""
    shots = tuple(photograph(place_view(*place), water) for place in places)
    return make_task(state, load_wall(water), PICTURE_SIZE, shots)
