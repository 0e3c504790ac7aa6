"""SPPM in media: furnace, closed forms, and Mitsuba's `volpathmis`."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from tests.foggy import NULL, cloud, fog_box, medium
from tests.furnace import (
    Scene,
    camera,
    diffuse,
    lamp,
    point_light,
    rectangle,
    render,
    rgb,
    sppm,
)

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
    images = render(scene, sppm(100_000, radius=0.1), 40, 4)
    error = images.mean((1, 2, 3)).std(ddof=1) / 2
    assert images.mean() == pytest.approx(1, abs=5e-3 + 3 * error) and error < 3e-3


def test_light_that_is_scattered_once():
    """A point light in a medium: L = ∫ σ_s / 4π I / d² exp(-σ_t (t + d)) dt along the ray."""
    extinction, albedo, intensity = 0.7, 0.5, 3.0
    air = medium(extinction, albedo) | {"id": "air"}
    view = camera((0, -3, 0), (0.5, 0, 0.4), 0.5, (64, 64)) | {
        "medium": {"type": "ref", "id": "air"}
    }
    scene: Scene = {"type": "scene", "air": air, "view": view}
    scene |= {"light": point_light((0, 0, 0), intensity)}
    scene |= {"floor": rectangle((0, 0, -50), (0, 0, 0), 1, 1, diffuse(0.5))}
    found = render(scene, sppm(1000, direct="emitters", max_depth=2), 20, 4)
    direction = np.array([0.5, 3, 0.4]) / np.linalg.norm([0.5, 3, 0.4])

    def integrand(t: float) -> float:
        d = np.linalg.norm(np.array([0, -3, 0]) + t * direction)
        return np.exp(-extinction * (t + d)) / d**2

    scattered = extinction * albedo / (4 * np.pi) * intensity * quad(integrand, 0, 60)[0]
    # Mitsuba's rays begin beyond the near plane and end before the lamp: .1 %.
    assert found.mean() == pytest.approx(scattered, rel=5e-3)


def test_a_beam():
    """A beam of parallel light crosses a medium: the radiance per width of the beam falls as
    exp(-σ_t x), seen at right angles through the distance D of medium in front of it."""
    extinction, albedo, side = 1.2, 0.4, 0.3
    light = {"type": "directionalarea", "radiance": rgb(1 / side**2)}  # 1 W
    beam = rectangle((0, 0, 1.5), (0, 0, 0), side, side, diffuse(0), emitter=light)
    scene: Scene = {
        "type": "scene",
        "sensor": camera((0, -20, 0), (0, 0, 0), 2.8, (80, 240)),
        "box": {"type": "cube", "bsdf": NULL, "interior": medium(extinction, albedo)},
        "beam": beam,
        "floor": rectangle((0, 0, -3), (0, 0, 0), 6, 6, diffuse(0.5)),
    }
    # Light that is scattered once; the side of the box counts as a bounce, twice.
    images = render(scene, sppm(100_000, radius=0.06, max_depth=4), 16, 4)
    width = 2 * 20 * np.tan(np.deg2rad(2.8 / 2))
    rows = images[..., 0].mean(axis=2).reshape(4, 12, 20).mean(axis=2)
    z = (np.arange(12)[::-1] - 5.5) * width / 4
    seen = (z > -0.8) & (z < 0.8)
    # The mean over the depth of the beam is a little more than in its middle.
    half = extinction * side / 2
    through = np.exp(-extinction * (1 - z + 1)) * np.sinh(half) / half
    expected = extinction * albedo / (4 * np.pi) * through / width
    error = rows.std(axis=0, ddof=1) / 2 / expected
    assert (error[seen] < 0.02).all()
    np.testing.assert_allclose((rows.mean(axis=0) / expected)[seen], 1, atol=0.02 + 2 * error.max())


@pytest.mark.parametrize("direct", ["photons", "emitters"])
def test_scattered_light_needs_an_edge_of_its_own(direct):
    """From the camera to a mirror, to the side of the fog, into it, and to the lamp: four edges."""
    scene: Scene = {
        "type": "scene",
        "sensor": camera((0, -2, 0), (0, -4, 0), 20),
        "mirror": rectangle((0, -4, 0), (0, 0, 0), 4, 4, {"type": "conductor"}),
        "box": {"type": "cube", "bsdf": NULL, "interior": medium(1)},
        "light": point_light((0, 0, 0.5), 3),
        "floor": rectangle((0, 0, -9), (0, 0, 0), 2, 2, diffuse(0.5)),
    }
    one_less, enough = (
        render(scene, sppm(2000, radius=0.3, direct=direct, max_depth=most), 4, 1)
        for most in (3, 4)
    )
    assert not one_less.any() and enough.mean() > 0.01


@pytest.mark.parametrize("direct", ["photons", "emitters"])
def test_fog_that_no_light_reaches(direct):
    """Its lamp shines away from it; or the path is too long."""
    away = lamp((0, 0, 2.5), (0, 0, 9), 1, 20)
    dark = render(fog_box(medium(1), lamp=away), sppm(1000, 0.1, direct=direct), 2, 1)
    assert not dark.any()
    short = sppm(1000, 0.1, direct=direct, max_depth=2)
    assert np.isfinite(render(fog_box(medium(1)), short, 2, 1)).all()


MEDIA = {
    "gray": lambda: medium(1.0),
    "colour": lambda: medium([0.5, 1.0, 3.0], [0.9, 0.8, 0.7]),
    "forward": lambda: medium(1.0, g=0.8),
    "backward": lambda: medium(1.0, g=-0.5),
    "grid": lambda: cloud(3.0),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("inside", "direct"),
    [
        pytest.param("gray", "photons", marks=pytest.mark.long),
        pytest.param("gray", "emitters", marks=pytest.mark.long),
        ("colour", "emitters"),
        ("forward", "photons"),
        pytest.param("backward", "emitters", marks=pytest.mark.long),
        ("grid", "emitters"),
    ],
)
def test_against_volpathmis(inside, direct):
    agrees(fog_box(MEDIA[inside](), size=(64, 64)), direct)


@pytest.mark.slow
def test_a_closed_room_filled_with_fog():
    """A cube without a surface around the fog would not do: there, Mitsuba's tracers lose light."""
    fog = {"type": "ref", "id": "fog"}
    view = camera((-0.7, -0.7, 0.2), (1, 0.8, -0.1), 60, (24, 24)) | {"medium": fog}
    room = {"type": "cube", "flip_normals": True, "bsdf": diffuse(0.6), "exterior": fog}
    light = lamp((0, 0, 0.9999), (0, 0, 0), 0.5, 5) | {"exterior": fog}
    parts = {"fog": medium(1, 0.8) | {"id": "fog"}, "view": view, "room": room, "light": light}
    agrees({"type": "scene"} | parts, "emitters")


@pytest.mark.slow
def test_a_camera_in_the_medium():
    # With more extinction, the few photons near the camera make the noise of all pixels.
    fog = medium([0.5, 0.8, 1.5], [0.9, 0.8, 0.7]) | {"id": "fog"}
    view = camera((0.3, -0.8, 0.5), (0, 0, 0), 70, (64, 64)) | {
        "medium": {"type": "ref", "id": "fog"}
    }
    box = {"type": "cube", "bsdf": NULL, "interior": {"type": "ref", "id": "fog"}}
    objects = fog_box(medium(1)) | {"box": box, "sensor": view}
    agrees({"type": "scene", "fog": fog} | objects, "emitters")


def agrees(scene: Scene, direct: str) -> None:
    ours = render(scene, sppm(100_000, radius=0.1, direct=direct), 40, 4)
    theirs = render(scene, VOLPATH, 256, 4, first=50)
    a, b = ours.mean((1, 2)), theirs.mean((1, 2))
    error = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / 4) / b.mean(0)
    ratio = a.mean(0) / b.mean(0)
    print(ratio.round(4), error.round(4), end=" ")
    assert (error < 5e-3).all()
    np.testing.assert_allclose(ratio, 1, atol=0.01 + 2 * error.max())
