"""The data set that `gpf render` writes: cameras, depth, normals and points."""

from __future__ import annotations

import json

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from gpf.core.structs import from_numpy
from gpf.scene.load import load_scene_file
from tests.commands.rendering import render, run


@pytest.fixture
def data(box) -> dict:
    """Three views in the folder `a`, read as a data set."""
    render("--orbit", "3", "--aovs", "depth,normal", "-o", "a")
    return json.loads((box / "a" / "transforms.json").read_text())


def test_depth_and_normals_are_those_of_the_rays(box, data):
    """Rays as its readers make them."""
    width, height, focal = data["w"], data["h"], data["fl_x"]
    assert (width, height) == (20, 16) and data["camera_model"] == "OPENCV"
    assert len(data["frames"]) == 3
    scene = load_scene_file(box / "box.xml")
    for frame in data["frames"]:
        with Image.open(box / "a" / frame["file_path"]) as picture:
            assert picture.size == (width, height)
        depth = np.load(box / "a" / frame["depth_file_path"]) * 1e-3
        with Image.open(box / "a" / frame["normal_file_path"]) as picture:
            normal = np.asarray(picture) / 127.5 - 1
        # OpenGL's camera: x to the right, y up, looking along -z.
        y, x = np.indices((height, width)) + 0.5
        camera = np.stack(
            [(x - data["cx"]) / focal, -(y - data["cy"]) / focal, -np.ones((height, width))], -1
        )
        pose = np.array(frame["transform_matrix"])
        way = (camera @ pose[:3, :3].T).reshape(-1, 3)
        ray = mi.Ray3f(mi.Point3f(pose[:3, 3]), from_numpy(mi.Vector3f, way))
        si = scene.ray_intersect(ray)
        hit = np.array(si.is_valid())
        np.testing.assert_allclose(np.array(si.t)[hit], depth.ravel()[hit], rtol=1e-4)
        assert (depth.ravel()[~hit] == 0).all()
        # Rays through an edge may take either side of it.
        other = np.abs(np.array(si.sh_frame.n).T[hit] - normal.reshape(-1, 3)[hit]).max(-1) > 0.01
        assert other.mean() < 0.02


def test_points_lie_in_the_scene_and_have_colours(box, data):
    lines = (box / "a" / data["ply_file_path"]).read_bytes()
    head, _, body = lines.partition(b"end_header\n")
    count = int(head.split(b"element vertex ")[1].split()[0])
    kinds = [(c, "<f4") for c in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")]
    rows = np.frombuffer(body, dtype=kinds)
    assert len(rows) == count > 500
    points = np.stack([rows[c] for c in "xyz"], axis=1)
    bounds = load_scene_file(box / "box.xml").bbox()
    assert (points > np.array(bounds.min) - 1e-3).all()
    assert (points < np.array(bounds.max) + 1e-3).all()
    assert np.stack([rows[c] for c in ("red", "green", "blue")]).max() > 100


def test_depth_and_normals_of_another_size_are_made_anew(box):
    both = ("--aovs", "depth,normal", "-o", "a", "--overwrite")
    render(*both)
    assert run("--size", "8x6", "--spp", "4", "-o", "a", "--overwrite") == 0
    assert run("--size", "8x6", "--spp", "4", *both) == 0
    assert np.load(box / "a" / "sensor_depth.npy").shape == (6, 8)
    with Image.open(box / "a" / "sensor_normal.png") as normal:
        assert normal.size == (8, 6)
    assert run("--size", "12x8", "--spp", "4", *both) == 0
    assert np.load(box / "a" / "sensor_depth.npy").shape == (8, 12)
