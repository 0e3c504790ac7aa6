"""Cameras as transforms.json: by the published conventions, and back."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from PIL import Image

from gpf.core.errors import UserError
from gpf.scene.pinhole import make_pinhole
from gpf.scene.transforms import read_transforms, write_transforms
from gpf.scene.views import View

SIZE = (160, 120)
VIEWS = [
    View(name="front", origin=(0, 1, 4), target=(0, 0.5, 0), fov=40),
    View(name="side", origin=(3, 2, -1), target=(0.2, 0, 0), up=(0, 0, 1), fov=55, fov_axis="y"),
    View(name="shifted", origin=(0, 1, 4), target=(0, 0.5, 0), fov=40, shift=(0.1, -0.2)),
]


def frame(**keys) -> dict:
    return {"transform_matrix": np.eye(4).tolist(), **keys}


def written(tmp_path, content) -> object:
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


POSE = np.eye(4).tolist()


def test_there_and_back(tmp_path):
    path = tmp_path / "transforms.json"
    write_transforms(path, VIEWS, SIZE)
    read = read_transforms(path)
    assert read.aspect == pytest.approx(4 / 3) and [v.name for v in read.train] == [
        v.name for v in VIEWS
    ]
    points = np.random.default_rng(1).uniform(-1, 1, (50, 3))
    for before, after in zip(VIEWS, read.train, strict=True):
        expected, depth = make_pinhole(before, SIZE).project(points)
        found, found_depth = make_pinhole(after, SIZE).project(points)
        np.testing.assert_allclose(found, expected, atol=1e-6)
        np.testing.assert_allclose(found_depth, depth, rtol=1e-9)


def test_points_land_where_the_convention_of_nerf_has_them(tmp_path):
    """By its definition alone: rays are ((u - cx) / f, -(v - cy) / f, -1) in the camera."""
    path = tmp_path / "transforms.json"
    write_transforms(path, VIEWS[:1], SIZE, {"front": {"file_path": "images/front.png"}})
    content = json.loads(path.read_text(encoding="utf-8"))
    camera = content["frames"][0]
    assert camera["file_path"] == "images/front.png"
    assert content["fl_x"] == pytest.approx(80 / math.tan(math.radians(20)))
    matrix = np.array(camera["transform_matrix"])
    u, v = 100.0, 30.0
    ray = matrix[:3, :3] @ [
        (u - content["cx"]) / content["fl_x"],
        -(v - content["cy"]) / content["fl_y"],
        -1,
    ]
    pixel, depth = make_pinhole(VIEWS[0], SIZE).project((matrix[:3, 3] + 2.5 * ray)[None])
    np.testing.assert_allclose(pixel, [[u, v]], atol=1e-9)
    assert depth[0] == pytest.approx(2.5)


def test_angles_and_names_from_elsewhere(tmp_path):
    frames = [frame(file_path="./train/r_0.png"), frame(file_path="./test/r_0.png"), frame()]
    content = {"camera_angle_x": 0.7, "w": 800, "h": 800, "frames": frames}
    views = read_transforms(written(tmp_path, content)).train
    assert [v.name for v in views] == ["r_0", "r_0_2", "view"]
    assert views[0].fov == pytest.approx(math.degrees(0.7))
    assert views[0].target == (0, 0, -1) and views[0].up == (0, 1, 0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"frames": []}, "has no frames"),
        ({"frames": [{}], "w": 4, "h": 4, "fl_x": 4}, r"frames\[0\]: has no transform_matrix"),
        ({"frames": [frame()], "fl_x": 4}, "has no image size"),
        ({"frames": [frame()], "w": 4, "h": 4}, "has no focal length"),
        ({"frames": [frame(k1=0.1)], "w": 4, "h": 4, "fl_x": 4}, "lens distortion .k1."),
        ({"frames": [frame()], "w": 4, "h": 4, "fl_x": 4, "fl_y": 5}, "non-square"),
        (
            {"frames": [frame(w=4), frame(w=8)], "h": 4, "fl_x": 4},
            "different aspect ratios",
        ),
        (
            {"frames": [{"transform_matrix": np.diag([-1.0, 1, 1, 1]).tolist()}], "w": 4, "h": 4},
            "is not a rotation",
        ),
    ],
)
def test_what_is_no_pinhole_camera_is_refused_in_words(tmp_path, content, message):
    with pytest.raises(UserError, match=message):
        read_transforms(written(tmp_path, content))


@pytest.mark.parametrize(
    "frame",
    [
        7,
        {"transform_matrix": POSE, "w": "wide", "h": 8, "fl_x": 10},
        {"transform_matrix": POSE, "w": 8, "h": 8, "fl_x": 0, "fl_y": 1},
        {"transform_matrix": [[1, 0], [1]], "w": 8, "h": 8, "fl_x": 10},
        {"transform_matrix": POSE, "w": 8, "h": None, "fl_x": 10},
    ],
)
def test_values_of_the_wrong_kind_are_told_with_their_frame(tmp_path, frame):
    file = tmp_path / "transforms.json"
    file.write_text(json.dumps({"frames": [frame]}))
    with pytest.raises(UserError, match=r"transforms.json: frames\[0\]: .*Correct the frame"):
        read_transforms(file)


def test_the_size_may_be_that_of_the_images(tmp_path):
    """As in the scenes of NeRF: no `w` and `h`, and paths without a suffix."""
    (tmp_path / "train").mkdir()
    Image.new("RGB", (12, 8)).save(tmp_path / "train" / "r_0.png")
    frame = {"file_path": "./train/r_0", "transform_matrix": POSE}
    file = tmp_path / "transforms.json"
    file.write_text(json.dumps({"camera_angle_x": 0.7, "frames": [frame]}))
    views = read_transforms(file)
    assert views.aspect == 1.5 and views.train[0].name == "r_0"
    assert views.train[0].fov == pytest.approx(math.degrees(0.7))
    (tmp_path / "train" / "r_0.png").write_bytes(b"no image")
    with pytest.raises(UserError, match=r"r_0\.png: cannot be read .* Give `w` and `h`"):
        read_transforms(file)
    del frame["file_path"]
    file.write_text(json.dumps({"camera_angle_x": 0.7, "frames": [frame]}))
    with pytest.raises(UserError, match="has no image size"):
        read_transforms(file)


def test_a_file_that_is_missing_or_no_json(tmp_path):
    with pytest.raises(UserError, match="does not exist"):
        read_transforms(tmp_path / "transforms.json")
    (tmp_path / "transforms.json").write_text("views:", encoding="utf-8")
    with pytest.raises(UserError, match="is not a JSON file"):
        read_transforms(tmp_path / "transforms.json")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"[" * 100_000, r"is not a JSON file \(maximum recursion"),
        (b'{"frames": "\xff"}', r"is not a JSON file \('utf-8'"),
    ],
)
def test_files_that_are_too_deep_or_not_utf_8_are_told(tmp_path, data, words):
    path = tmp_path / "transforms.json"
    path.write_bytes(data)
    with pytest.raises(UserError, match=rf"transforms\.json: {words}"):
        read_transforms(path)


def test_an_aspect_beyond_all_images_is_told(tmp_path):
    content = {"w": 1e9, "h": 1, "fl_x": 1, "frames": [frame(name="a")]}
    with pytest.raises(
        UserError, match=r"transforms\.json: aspect: is 1000000000\.0\. Input should"
    ):
        read_transforms(written(tmp_path, content))


def test_an_image_that_is_a_bomb_is_told(tmp_path):
    import struct
    import zlib

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = chunk(b"IHDR", struct.pack(">2I5B", 60000, 60000, 8, 2, 0, 0, 0))
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + head + chunk(b"IEND", b""))
    path = written(tmp_path, {"fl_x": 1, "frames": [frame(file_path="a.png")]})
    with pytest.raises(UserError, match=r"a\.png: cannot be read"):
        read_transforms(path)
