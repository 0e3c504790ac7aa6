"""Lamps of Blender as emitters: their light on a floor, and where a sun stands in the sky."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest

from gpf.blender.lights import emitters, sky
from gpf.blender.scene_dict import cameras

NOTHING = np.diag([0.0, 0.0, 0.0, 1.0]) + np.outer([0, 0, 2.0, 0], [0, 0, 0, 1])
"""The matrix of a lamp that is scaled to nothing: points shine in spite of it."""


def lamp(kind: str, **more):
    """A lamp of 100 W two metres above the origin, which shines downwards."""
    matrix = np.eye(4)
    matrix[2, 3] = 2.0
    whole = {"type": kind, "name": "it", "color": [1.0, 0.5, 0.25], "energy": 100.0}
    return whole | {"matrix": matrix.tolist()} | more


def irradiance(found) -> np.ndarray:
    """At the origin of a floor, W/m², (3,)."""
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
    look = mi.ScalarTransform4f().look_at([0, -1, 1], [0, 0, 0], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "floor": {"type": "rectangle", "bsdf": white},
        "camera": {"type": "perspective", "to_world": look, "fov": 0.1, "film": film},
        "integrator": {"type": "path", "max_depth": 2},
    }
    image = mi.render(mi.load_dict(scene | found), spp=4096)
    return math.pi * np.array(image).ravel()[:3]


@pytest.mark.parametrize(
    ("kind", "more", "expected"),
    [
        ("POINT", {"radius": 0.0}, 100 / (4 * math.pi) / 4),
        ("POINT", {"radius": 0.1}, 100 / (4 * math.pi) / 4),
        ("POINT", {"radius": 0.1, "matrix": NOTHING}, 100 / (4 * math.pi) / 4),
        ("SPOT", {"radius": 0.0, "spot_size": 0.5, "spot_blend": 0.0}, 100 / (4 * math.pi) / 4),
        ("AREA", {"size": [0.1, 0.1], "spread": math.pi, "round": False}, 100 / math.pi / 4),
        ("AREA", {"size": [0.1, 0.2], "spread": math.pi, "round": True}, 100 / math.pi / 4),
        ("SUN", {"angle": 0.0}, 100),
    ],
)
def test_a_lamp_gives_its_power(kind, more, expected):
    found = irradiance(emitters([lamp(kind, **more)], []))
    np.testing.assert_allclose(found, expected * np.array([1, 0.5, 0.25]), rtol=0.01)


@pytest.mark.parametrize("angle", [0.1, 0.0092])
@pytest.mark.parametrize("sine", [0.6, 0.0, 0.003])
def test_a_sun_with_an_angle_is_a_disc_in_the_sky(tmp_path, two_threads, angle, sine):
    tilted, cosine = lamp("SUN", angle=angle), (1 - sine**2) ** 0.5
    turn = [[cosine, 0, sine, 0], [0, 1, 0, 0], [-sine, 0, cosine, 0], [0, 0, 0, 1.0]]
    tilted["matrix"] = turn
    found = sky({"radiance": [0.0, 0.0, 1.0]}, [tilted], tmp_path, tmp_path)
    found["sky"]["filename"] = str(tmp_path / found["sky"]["filename"])
    expected = 100 * cosine * np.array([1, 0.5, 0.25]) + [0, 0, math.pi]
    np.testing.assert_allclose(irradiance(found), expected, rtol=0.02)


def test_the_sky_without_a_sun(tmp_path):
    assert sky(None, [lamp("SUN", angle=0.0)], tmp_path, tmp_path) == {}
    found = sky({"radiance": [0.1, 0.2, 0.3]}, [], tmp_path, tmp_path)
    np.testing.assert_allclose(irradiance(found), math.pi * np.array([0.1, 0.2, 0.3]), rtol=0.01)


def test_cameras_look_where_blenders_do():
    """Along -z, with +y up; the shift moves what is seen."""
    camera = {"name": "eye", "type": "PERSP", "fov": 90.0, "fov_axis": "x", "clip": [0.1, 100.0]}
    camera |= {"matrix": np.eye(4).tolist(), "shift": [0.25, 0.0], "blurred": False}
    ortho = camera | {"type": "ORTHO", "name": "plan"}
    notes: list[str] = []
    made = cameras({"size": [200, 100], "cameras": [camera, ortho]}, notes)
    assert list(made) == ["eye"] and notes == ["camera plan: ortho camera left out"]
    sensor = mi.load_dict(made["eye"])
    ray, _ = sensor.sample_ray(0, 0, [0.5, 0.5], 0)
    # Blender's shift of a quarter of the width: what was in the middle is a quarter further left.
    np.testing.assert_allclose(
        np.array(ray.d).ravel(), np.array([0.5, 0, -1]) / 1.25**0.5, atol=1e-5
    )
