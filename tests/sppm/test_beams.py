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
from tests.foggy import NULL, medium
from tests.furnace import Scene, camera, diffuse, rectangle, render, sppm

SIZE, FOV, EXTINCTION, ALBEDO, G = 96, 13.0, 0.6, 0.9, 0.5
EYE, HALF = np.array([0.2, -5.0, 0.0]), 1.4


def beside_a_ball() -> Scene:
    """A spotlight and a ball of glass in a cube of fog; the camera sees the light that the ball has
    focussed, in front of a black wall, and not the ball itself. No fog is near the eye, where few
    photons would make the noise of many pixels."""
    fog = {"type": "ref", "id": "fog"}
    aim = mi.ScalarTransform4f().look_at([-3, 0, 0], [0, 0, 0], [0, 0, 1])
    spot = {"type": "spot", "cutoff_angle": 14, "beam_width": 13, "to_world": aim}
    ball = {"type": "sphere", "center": [-0.8, 0, 0], "radius": 0.5, "exterior": fog}
    cube = {"type": "cube", "to_world": mi.ScalarTransform4f().scale(HALF), "bsdf": NULL}
    return {
        "type": "scene",
        "fog": medium(EXTINCTION, ALBEDO, G) | {"id": "fog"},
        "sensor": camera(EYE, (EYE[0], 0, 0), FOV, (SIZE, SIZE)),
        "cube": cube | {"interior": fog},
        "ball": ball | {"bsdf": {"type": "dielectric", "int_ior": 1.5}},
        "lamp": spot | {"intensity": {"type": "rgb", "value": 10}},
        "wall": rectangle((0, 3, 0), (0, 0, 0), 9, 6, diffuse(0)),
    }


def by_beams(scene: mi.Scene, paths: int, seed: int) -> np.ndarray:
    """The picture from one pass of photons, (SIZE, SIZE)."""
    _, photons = record_all(scene, PathSettings(paths), seed)
    p, d = photons.p.numpy().T - EYE, photons.n.numpy().T
    half = np.tan(np.deg2rad(FOV / 2))
    seen = (abs(p[:, ::2]) < half * p[:, 1:2]).all(1)
    p, d = p[seen], d[seen]
    column, row = ((SIZE * (1 + p[:, ::2] * (1, -1) / p[:, 1:2] / half) / 2).astype(int)).T
    t = np.linalg.norm(p, axis=1)
    cosine = -(d * p).sum(1) / t  # of the angle between the photon's flight and the way to the eye
    phase = (1 - G**2) / (4 * np.pi * (1 + G**2 - 2 * G * cosine) ** 1.5)
    inside = t * (1 + (HALF + EYE[1]) / p[:, 1])  # how far the light goes through the fog
    light = np.exp(-EXTINCTION * inside) * phase * photons.power.numpy()[0][seen] / t**2
    light *= EXTINCTION * ALBEDO / (p[:, 1] / t) ** 3
    image = np.bincount(row * SIZE + column, light, SIZE**2)
    return image.reshape(SIZE, SIZE) / (2 * half / SIZE) ** 2


@pytest.mark.slow
def test_points_and_beams_agree():
    description = beside_a_ball()
    scene = mi.load_dict(description)
    beams = np.mean(
        [[by_beams(scene, 100_000, 8 * k + j) for j in range(8)] for k in range(4)], axis=1
    )
    points = render(description, sppm(50_000), 40, 4, first=50)[..., 0]

    def means(images: np.ndarray) -> np.ndarray:
        """Of squares of 16 x 16 pixels, (4, 36)."""
        return images.reshape(len(images), 6, 16, 6, 16).mean((2, 4)).reshape(len(images), -1)

    a, b = means(points), means(beams)
    # Beside the beam, the few photons near the eye make the noise.
    bright = b.mean(0) > 0.5 * b.mean(0).max()
    assert 4 <= bright.sum() <= 24 and b.mean(0).max() > 3 * b.mean(0).min()
    a, b = a[:, bright], b[:, bright]
    error = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / 4) / b.mean(0)
    ratio = a.mean(0) / b.mean(0)
    print(f"{a.mean() / b.mean():.4f}", ratio.round(3), error.round(3))
    whole = np.sqrt((a.mean(1).var(ddof=1) + b.mean(1).var(ddof=1)) / 4) / b.mean()
    assert whole < 0.01
    assert a.mean() / b.mean() == pytest.approx(1, abs=0.01 + 2 * whole)
    np.testing.assert_allclose(ratio, 1, atol=0.03 + 3 * error.max())
