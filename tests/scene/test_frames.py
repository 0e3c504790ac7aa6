"""The frames of scenes that move."""

import pytest

from gpf.core.errors import UserError
from gpf.scene.frames import choose_frames, scene_frames

EMPTY = '<scene version="3.9.0"/>'
MOVES = """<scene version="3.9.0"><default name="frame" value="1"/>
<shape type="ply"><string name="filename" value="meshes/water_$frame.ply"/></shape>
<shape type="ply"><string name="filename" value="meshes/still.ply"/></shape>
<shape type="ply"><string name="filename" value="$frame/ball_$frame.ply"/></shape></scene>"""


def touch(*files):
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(EMPTY, encoding="utf-8")


def test_a_folder_of_scene_files(tmp_path):
    names = ["shot2_9", "shot2_10", "shot2_011"]
    touch(*(tmp_path / f"{name}.xml" for name in names), tmp_path / "common.xml")
    frames = scene_frames(tmp_path)
    assert [frame.name for frame in frames] == names
    assert frames[1].file == tmp_path / "shot2_10.xml" and not frames[1].parameters


def test_numbers_below_zero(tmp_path):
    names = ["shot_-2", "shot_-1", "shot-0", "shot-1"]
    touch(*(tmp_path / f"{name}.xml" for name in names))
    assert [frame.name for frame in scene_frames(tmp_path)] == names
    file = tmp_path / "pool.xml"
    file.write_text(MOVES, encoding="utf-8")
    for n in ("-1", "-2", "0"):
        touch(tmp_path / f"meshes/water_{n}.ply", tmp_path / f"{n}/ball_{n}.ply")
    assert [frame.name for frame in scene_frames(file)] == ["pool_-2", "pool_-1", "pool_0"]


def test_a_folder_of_scene_folders(tmp_path):
    touch(*(tmp_path / name / "scene.xml" for name in ("0002", "0001", "textures")))
    assert [frame.file.parent.name for frame in scene_frames(tmp_path)] == ["0001", "0002"]


def test_one_file_with_a_mesh_for_each_frame(tmp_path):
    file = tmp_path / "pool.xml"
    file.write_text(MOVES, encoding="utf-8")
    touch(*(tmp_path / f"meshes/water_{n}.ply" for n in ("07", "08", "10", "x")))
    touch(
        *(tmp_path / f"{n}/ball_{n}.ply" for n in ("07", "10", "12", "x")),
        tmp_path / "08/ball_07.ply",
    )
    frames = scene_frames(file)
    assert [(frame.name, frame.parameters) for frame in frames] == [
        ("pool_07", {"frame": "07"}),
        ("pool_10", {"frame": "10"}),
    ]


def test_what_does_not_move_is_told(tmp_path):
    file = tmp_path / "still.xml"
    touch(
        file, tmp_path / "folder/still.xml", tmp_path / "twice/a_1.xml", tmp_path / "twice/b_01.xml"
    )
    with pytest.raises(UserError, match="does not move"):
        scene_frames(file)
    with pytest.raises(UserError, match="has no frames"):
        scene_frames(tmp_path / "folder")
    with pytest.raises(UserError, match="frame 1 twice: (a_1 and b_01|b_01 and a_1)"):
        scene_frames(tmp_path / "twice")
    file.write_text(MOVES, encoding="utf-8")
    with pytest.raises(UserError, match="no value of .frame for which all"):
        scene_frames(file)


def test_some_frames():
    assert choose_frames("all", 5, "it") == slice(0, 5)
    assert choose_frames("1:3", 5, "it") == slice(1, 3)
    assert choose_frames(":3", 5, "it") == slice(0, 3)
    assert choose_frames("2:", 5, "it") == slice(2, 5)
    for wrong in ("3:2", "0:6", "1", "a", "-1:2"):
        with pytest.raises(UserError, match="does not name frames of it, which has 5"):
            choose_frames(wrong, 5, "it")
