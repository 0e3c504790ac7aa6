"""SPPM in media: furnace, closed forms, and Mitsuba's `volpathmis`."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from tests.foggy import NULL, cloud, fog_box, medium
from tests.furnace import Scene, camera, diffuse, point_light, rectangle, render, rgb, sppm

VOLPATH = {"type": "volpathmis", "max_depth": 100, "rr_depth": 20}


@pytest.mark.parametrize(
    ("extinction", "g"), [(1.0, 0.0), ([0.5, 1.0, 2.0], 0.7), (0.2, -0.5)], ids=str
)
def test_in_a_furnace_radiance_is_the_same_everywhere(extinction, g):
    """Nothing absorbs, and the sky is everywhere the same."""
    scene = fog_box(
        medium(extinction, albedo=1, g=g),
        size=(12, 12),
        lamp={"type": "constant", "radiance": rgb(1)},
        floor=rectangle((0, 0, -1.2), (0, 0, 0), 3, 3, {"type": "twosided", "b": diffuse(1)}),
        ball={"type": "sphere", "radius": 0.4, "bsdf": diffuse(1)},
    )
    images = render(scene, sppm(40_000, radius=0.1), 24, 4)
    error = images.mean((1, 2, 3)).std(ddof=1) / 2
    assert images.mean() == pytest.approx(1, abs=5e-3 + 3 * error) and error < 3e-3


def test_light_that_is_scattered_once():
    """A point light in a medium: L = ∫ σ_s / 4π I / d² exp(-σ_t (t + d)) dt along the ray."""
    extinction, albedo, intensity = 0.7, 0.5, 3.0
    air = medium(extinction, albedo) | {"id": "air"}
    view = camera((0, -3, 0), (0.5, 0, 0.4), 1, (2, 2)) | {"medium": {"type": "ref", "id": "air"}}
    scene: Scene = {"type": "scene", "air": air, "view": view}
    scene |= {"light": point_light((0, 0, 0), intensity)}
    scene |= {"floor": rectangle((0, 0, -50), (0, 0, 0), 1, 1, diffuse(0.5))}
    found = render(scene, sppm(1000, direct="emitters", max_depth=2), 2000, 4).mean((1, 2))
    direction = np.array([0.5, 3, 0.4]) / np.linalg.norm([0.5, 3, 0.4])

    def integrand(t: float) -> float:
        d = np.linalg.norm(np.array([0, -3, 0]) + t * direction)
        return np.exp(-extinction * (t + d)) / d**2

    scattered = extinction * albedo / (4 * np.pi) * intensity * quad(integrand, 0, 60)[0]
    error = found.std(ddof=1) / len(found) ** 0.5 / 3**0.5
    assert found.mean() == pytest.approx(scattered, abs=4 * error) and error < 0.01 * scattered


def test_a_beam():
    """A thin beam of parallel light crosses a medium: the radiance per width of the beam falls as
    exp(-σ_t x), seen at right angles through the distance D of medium in front of it."""
    extinction, albedo, side = 1.2, 0.4, 0.05
    light = {"type": "directionalarea", "radiance": rgb(1 / side**2)}  # 1 W
    beam = rectangle((0, 0, 1.5), (0, 0, 0), side, side, diffuse(0), emitter=light)
    scene: Scene = {
        "type": "scene",
        "sensor": camera((0, -20, 0), (0, 0, 0), 5.6, (4, 12)),
        "box": {"type": "cube", "bsdf": NULL, "interior": medium(extinction, albedo)},
        "beam": beam,
        "floor": rectangle((0, 0, -3), (0, 0, 0), 6, 6, diffuse(0.5)),
    }
    images = render(scene, sppm(100_000, radius=0.06, max_depth=3), 16, 4)
    rows = images[..., 0].mean(axis=2)  # the mean over a row of pixels
    width = 2 * 20 * np.tan(np.deg2rad(5.6 / 2))
    pixel = width / 4
    z = (np.arange(12)[::-1] - 5.5) * pixel
    depth = 1 - z
    through = np.exp(-extinction * (depth + 1))
    expected = extinction * albedo / (4 * np.pi) * through / width
    seen = (z > -0.8) & (z < 0.8)
    error = rows[:, seen].std(axis=0, ddof=1) / 2
    np.testing.assert_allclose(rows[:, seen].mean(axis=0), expected[seen], rtol=0.02)
    assert (error < 0.02 * expected[seen]).all()


MEDIA = {
    "gray": lambda: medium(1.0),
    "colour": lambda: medium([0.5, 1.0, 3.0], [0.9, 0.8, 0.7]),
    "forward": lambda: medium(1.0, g=0.8),
    "backward": lambda: medium(1.0, g=-0.5),
    "grid": lambda: cloud(3.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("inside", MEDIA)
@pytest.mark.parametrize("direct", ["photons", "emitters"])
def test_against_volpathmis(inside, direct):
    agrees(fog_box(MEDIA[inside](), size=(16, 16)), direct)


@pytest.mark.slow
def test_a_camera_in_the_medium():
    fog = medium([0.5, 1.0, 3.0], [0.9, 0.8, 0.7]) | {"id": "fog"}
    view = camera((0.3, -0.8, 0.5), (0, 0, 0), 70, (16, 16)) | {
        "medium": {"type": "ref", "id": "fog"}
    }
    box = {"type": "cube", "bsdf": NULL, "interior": {"type": "ref", "id": "fog"}}
    objects = fog_box(medium(1)) | {"box": box, "sensor": view}
    agrees({"type": "scene", "fog": fog} | objects, "emitters")


def agrees(scene: Scene, direct: str) -> None:
    ours = render(scene, sppm(50_000, radius=0.1, direct=direct), 60, 4)
    theirs = render(scene, VOLPATH, 1024, 4, first=50)
    a, b = ours.mean((1, 2)), theirs.mean((1, 2))
    error = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / 4) / b.mean(0)
    ratio = a.mean(0) / b.mean(0)
    print(ratio.round(4), error.round(4), end=" ")
    assert (error < 5e-3).all()
    np.testing.assert_allclose(ratio, 1, atol=0.01 + 2 * error.max())
