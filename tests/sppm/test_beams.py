"""SPPM's points in media against the beam estimate: another estimator, the same light.

The beam estimate (Jarosz et al. 2008) takes all photons around a camera ray, at any distance. Here
its kernel is the pixel itself, so that nothing is blurred:

    L = 1 / A Σ T(t_i) σ_s f(ω_i, ω) Φ_i / (t_i² cos³θ_i)    over photons that the pixel sees,

with the pixel's area A at a distance of 1.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.photons.tracing import PathSettings, record_all
from tests.foggy import medium
from tests.furnace import Scene, camera, diffuse, rectangle, render, sppm

SIZE, FOV, EXTINCTION, ALBEDO, G = 24, 22.0, 0.3, 0.6, 0.5
EYE, WALL = np.array([0.2, -3.0, 0.0]), 1.5


def beside_a_ball() -> Scene:
    """A spotlight and a ball of glass in fog that is everywhere; the camera sees the light that the
    ball has focussed, in front of a black wall, and not the ball itself."""
    fog = {"type": "ref", "id": "fog"}
    aim = mi.ScalarTransform4f().look_at([-3, 0, 0], [0, 0, 0], [0, 0, 1])
    spot = {"type": "spot", "cutoff_angle": 14, "beam_width": 13, "to_world": aim, "medium": fog}
    ball = {"type": "sphere", "center": [-1, 0, 0], "radius": 0.5, "exterior": fog}
    return {
        "type": "scene",
        "fog": medium(EXTINCTION, ALBEDO, G) | {"id": "fog"},
        "sensor": camera(EYE, (EYE[0], 0, 0), FOV, (SIZE, SIZE)) | {"medium": fog},
        "ball": ball | {"bsdf": {"type": "dielectric", "int_ior": 1.5}},
        "lamp": spot | {"intensity": {"type": "rgb", "value": 10}},
        "wall": rectangle((0, WALL, 0), (0, 0, 0), 9, 6, diffuse(0), exterior=fog),
    }


def by_beams(scene: mi.Scene, paths: int, seed: int) -> np.ndarray:
    """The picture from one pass of photons, (SIZE, SIZE)."""
    _, photons = record_all(scene, PathSettings(paths), seed)
    p, d = photons.p.numpy().T - EYE, photons.n.numpy().T
    half = np.tan(np.deg2rad(FOV / 2))
    seen = (p[:, 1] > 0) & (p[:, 1] < WALL - EYE[1])
    seen &= (abs(p[:, ::2]) < half * p[:, 1:2]).all(1)
    p, d = p[seen], d[seen]
    column, row = ((SIZE * (1 + p[:, ::2] * (1, -1) / p[:, 1:2] / half) / 2).astype(int)).T
    t = np.linalg.norm(p, axis=1)
    cosine = -(d * p).sum(1) / t  # of the angle between the photon's flight and the way to the eye
    phase = (1 - G**2) / (4 * np.pi * (1 + G**2 - 2 * G * cosine) ** 1.5)
    light = np.exp(-EXTINCTION * t) * phase * photons.power.numpy()[0][seen] / t**2
    light *= EXTINCTION * ALBEDO / (p[:, 1] / t) ** 3
    image = np.bincount(row * SIZE + column, light, SIZE**2)
    return image.reshape(SIZE, SIZE) / (2 * half / SIZE) ** 2


@pytest.mark.slow
def test_points_and_beams_agree():
    description = beside_a_ball()
    scene = mi.load_dict(description)
    passes = [[by_beams(scene, 200_000, 16 * k + j) for j in range(16)] for k in range(4)]
    beams = np.mean(passes, axis=1)
    points = render(description, sppm(100_000, radius=0.06), 30, 4, first=50)[..., 0]

    def means(images: np.ndarray) -> np.ndarray:
        """Of squares of 4 x 4 pixels, and of all."""
        squares = images.reshape(len(images), 6, 4, 6, 4).mean((2, 4)).reshape(len(images), -1)
        return np.concatenate([squares, images.mean((1, 2))[:, None]], axis=1)

    a, b = means(points), means(beams)
    ratio = a.mean(0) / b.mean(0)
    error = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / 4) / b.mean(0)
    print(ratio.round(3), error.round(3))
    # Somewhere in the picture, light is focussed; elsewhere it is not.
    assert b.mean(0)[:-1].max() > 3 * b.mean(0)[:-1].min()
    assert ratio[-1] == pytest.approx(1, abs=0.01 + 2 * error[-1])
    np.testing.assert_allclose(ratio, 1, atol=0.03 + 4 * error.max())
