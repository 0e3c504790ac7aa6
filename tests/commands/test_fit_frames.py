"""``gpf fit --frames`` and ``gpf render --frames``: fields and pictures of an animation."""

from __future__ import annotations

import json
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.cli import main
from gpf.core.images import read_exr
from gpf.field.io import load_field
from tests.small_fit import make_small

ROOM = """<scene version="3.0.0">
  <sensor type="perspective">
    <float name="fov" value="50"/>
    <transform name="to_world"><lookat origin="0,-3,1" target="0,0,0.4" up="0,0,1"/></transform>
    <film type="hdrfilm">
      <integer name="width" value="32"/><integer name="height" value="32"/>
    </film>
  </sensor>
  <shape type="rectangle" id="floor">
    <transform name="to_world"><scale value="2"/></transform>
  </shape>
  <shape type="sphere" id="ball">
    <point name="center" x="{x}" y="0" z="0.3"/><float name="radius" value="0.3"/>
  </shape>
  <shape type="rectangle" id="lamp">
    <transform name="to_world">
      <scale value="0.5"/><rotate x="1" angle="180"/><translate z="2"/>
    </transform>
    <emitter type="area"><rgb name="radiance" value="{light}"/></emitter>
  </shape>
</scene>
"""
VIEWS = """aspect: 1.0
views:
  train:
    - {name: front, origin: [0, -3, 1], target: [0, 0, 0.4], up: [0, 0, 1], fov: 50}
"""


def animate(folder: Path, light: float = 10, frames: int = 3) -> Path:
    """A ball that rolls."""
    folder.mkdir()
    for frame in range(frames):
        text = ROOM.format(x=0.1 * frame, light=light)
        (folder / f"frame_{frame:04d}.xml").write_text(text)
    (folder / "views.yaml").write_text(VIEWS)
    return folder


def run(*arguments: str | Path, command: str = "fit") -> int:
    with pytest.raises(SystemExit) as ended:
        main([command, *map(str, arguments)])
    return int(ended.value.code or 0)


def light_under_the_ball(file: Path) -> float:
    """Mean irradiance of the floor in its shadow and beside it."""
    x = np.linspace(-0.6, 1, 40, dtype=np.float32)
    p, n = mi.Point3f(mi.Float(x), -0.35, 0), mi.Normal3f(0, 0, 1)
    value, _ = load_field(file).query(p, n, dr.full(mi.Bool, True, len(x)))
    return float(np.mean(value.numpy()))


@pytest.fixture
def small(monkeypatch):
    make_small(monkeypatch, passes=30, steps=60, paths=5_000)
    monkeypatch.setattr("gpf.commands.fit_frames.ROWS", 32)


def test_an_interrupted_fit_goes_on(tmp_path, small, capsys):
    scenes = animate(tmp_path / "rolling")
    common = "--passes", "6", "--frames"
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert run(scenes, *common, "all", "-o", whole) == 0
    assert run(scenes, *common, "0:2", "-o", parts) == 0
    capsys.readouterr()
    assert run(scenes, *common, "all", "-o", parts) == 0
    assert "2 of 3 frames are done" in capsys.readouterr().err
    names = [file.name for file in sorted(whole.glob("*.safetensors"))]
    assert names == [f"frame_{frame:04d}.safetensors" for frame in range(3)]
    for name in names[:2]:  # the beginning has the time that it took
        assert (parts / name).read_bytes()[-10_000:] == (whole / name).read_bytes()[-10_000:]
    # A file rounds places, in the last bit.
    last, expected = (light_under_the_ball(folder / names[2]) for folder in (parts, whole))
    assert last == pytest.approx(expected, rel=0.02)


def test_a_data_set_with_a_time(tmp_path, small, capsys):
    scenes, fields, pictures = animate(tmp_path / "rolling"), tmp_path / "fields", tmp_path / "set"
    assert run(scenes, "--passes", "6", "--frames", "all", "-o", fields) == 0
    cheap = "--frames", "all", "--size", "24", "--spp", "2", "--aovs", "depth"
    shot = scenes, "--field", fields, *cheap, "-o", pictures
    assert run(*shot, command="render") == 0
    told = json.loads((pictures / "transforms.json").read_text())["frames"]
    assert [frame["file_path"] for frame in told] == [f"frame_{k:04d}.png" for k in range(3)]
    assert [frame["time"] for frame in told] == [0, 0.5, 1]
    depths = [np.load(pictures / frame["depth_file_path"]) for frame in told]
    near = [np.where(depth > 0, depth, np.inf)[:14].min(axis=0) for depth in depths]
    columns = [np.argmin(depth) for depth in near]  # where the ball is
    assert columns[0] < columns[1] < columns[2]
    capsys.readouterr()
    assert run(*shot, command="render") == 0
    assert "3 already done" in capsys.readouterr().err
    (fields / "frame_0001.safetensors").unlink()
    assert run(scenes, "--field", fields, *cheap, "-o", tmp_path / "b", command="render") == 2
    assert "frame_0001.safetensors: is missing" in capsys.readouterr().err
    assert run(scenes, *cheap, "-o", tmp_path / "b", command="render") == 2
    assert "fields: is not a folder with the fields" in " ".join(capsys.readouterr().err.split())


def test_fields_of_other_scenes_are_not_replaced(tmp_path, small, capsys):
    fields = tmp_path / "fields"
    assert run(animate(tmp_path / "one"), "--passes", "6", "--frames", "0:1", "-o", fields) == 0
    before = (fields / "frame_0000.safetensors").read_bytes()
    other = animate(tmp_path / "two", light=5), "--passes", "6", "--frames", "0:1", "-o", fields
    assert run(*other) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "was fitted to another scene" in said and "different lights. Add --overwrite" in said
    assert (fields / "frame_0000.safetensors").read_bytes() == before
    assert run(*other, "--overwrite") == 0
    assert (fields / "frame_0000.safetensors").read_bytes() != before


def test_a_frame_that_changed_by_little_is_fitted_again(tmp_path, small, capsys):
    """By a tenth of a millimetre, in a scene of metres."""
    scenes, fields = animate(tmp_path / "rolling"), tmp_path / "fields"
    fit = scenes, "--passes", "6", "--frames", "0:1", "-o", fields
    assert run(*fit) == 0
    scene = scenes / "frame_0000.xml"
    scene.write_text(scene.read_text().replace('center" x="0.0"', 'center" x="0.0001"'))
    pictures = "--field", fields, "--frames", "0:1", "--size", "16", "-o", tmp_path / "pictures"
    for other in (fit, (scenes, *pictures)):
        capsys.readouterr()
        assert run(*other, command="fit" if other is fit else "render") == 2
        assert "different geometry" in " ".join(capsys.readouterr().err.split())
    assert run(*fit, "--overwrite") == 0
    assert run(scenes, *pictures, command="render") == 0


def test_other_settings_are_said(tmp_path, small, capsys):
    scenes, fields = animate(tmp_path / "rolling"), tmp_path / "fields"
    fit = scenes, "--frames", "0:1", "-o", fields, "--passes"
    assert run(*fit, "6") == 0
    capsys.readouterr()
    other = *fit, "8", "--seed", "3", "--groups", "auto"
    assert run(*other) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "was fitted with other settings: passes, seed, groups. Add --overwrite" in said
    assert run(*other, "--overwrite") == 0
    assert load_field(fields / "frame_0000.safetensors").lights is not None
    assert run(*other) == 0
    assert "1 of 1 frames are done" in capsys.readouterr().err


def test_later_frames_go_on(tmp_path, small, capsys):
    """The third frame by itself is the one after the second, with whatever settings that has."""
    scenes, whole, parts = animate(tmp_path / "rolling"), tmp_path / "whole", tmp_path / "parts"
    common = scenes, "--passes", "6", "--frames"
    assert run(*common, "all", "-o", whole) == 0
    parts.mkdir()
    name = "frame_0001.safetensors"
    (parts / name).write_bytes((whole / name).read_bytes())
    assert run(*common, "2:3", "-o", parts) == 0
    capsys.readouterr()
    assert run(*common, "2:3", "-o", parts, "--seed", "1", "--overwrite") == 0
    assert "begins anew" not in capsys.readouterr().err
    assert run(*common, "2:3", "-o", parts, "--overwrite") == 0
    capsys.readouterr()
    assert run(*common, "2:3", "-o", tmp_path / "alone") == 0
    assert "frame_0002 begins anew" in capsys.readouterr().err
    found, expected, alone = (
        np.sort(load_field(folder / "frame_0002.safetensors").gaussians.means.numpy()[0])
        for folder in (parts, whole, tmp_path / "alone")
    )
    assert len(found) == pytest.approx(len(expected), rel=0.01)
    assert len(alone) != pytest.approx(len(expected), rel=0.01)


def test_a_lamp_that_is_off_in_a_frame(tmp_path, small, capsys):
    """Groups are those of the first frame, by the names of its lamps."""
    scenes, fields = animate(tmp_path / "rolling", frames=2), tmp_path / "fields"
    point = """<emitter type="point" id="spark">
      <point name="position" x="0.5" y="0" z="1"/><rgb name="intensity" value="3"/></emitter>"""
    first, second = scenes / "frame_0000.xml", scenes / "frame_0001.xml"
    shown = first.read_text()
    first.write_text(shown.replace("</scene>", f"{point}</scene>"))
    common = "--passes", "6", "--frames", "all", "-o", fields, "--groups", "auto"
    assert run(scenes, *common) == 0
    lights = [load_field(fields / f"frame_000{k}.safetensors").lights for k in range(2)]
    names = [each.groups.names for each in lights]
    assert names[0] == names[1] and set(names[0]) == {"lamp", "spark"}
    spark = names[0].index("spark")
    assert lights[1].groups.members[spark] == () and len(lights[0].groups.members[spark]) == 1
    assert np.abs(lights[1].irradiance[spark]).max() <= 1e-6 * lights[1].irradiance.max()
    shot = scenes, "--field", fields, "--frames", "all", "--size", "16", "--lights", "spark=0"
    assert run(*shot, "-o", tmp_path / "pictures", command="render") == 0
    pictures = [tmp_path / "pictures" / f"frame_000{k}.exr" for k in range(2)]
    assert all(read_exr(file)[0]["radiance"].max() > 0 for file in pictures)
    first.write_text(shown)
    second.write_text(shown.replace("</scene>", f"{point}</scene>"))
    capsys.readouterr()
    assert run(scenes, *common, "--overwrite") == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "frame_0001: emitter spark: is in none of the groups" in said
    off = point.replace('intensity" value="3"', 'intensity" value="0"')
    first.write_text(shown.replace("</scene>", f"{off}</scene>"))
    assert run(scenes, *common, "--overwrite") == 0
    lights = load_field(fields / "frame_0001.safetensors").lights
    assert lights.irradiance[spark].max() > 0.05 * lights.irradiance.max()


def test_each_folder_has_its_own_cameras(tmp_path, small, capsys):
    """Those of the first frame are the animation's, whatever frames are asked for."""
    flat, scenes = animate(tmp_path / "flat", frames=2), tmp_path / "rolling"
    for k in range(2):
        folder = scenes / f"{k:04d}"
        folder.mkdir(parents=True)
        (flat / f"frame_{k:04d}.xml").rename(folder / "scene.xml")
        views = VIEWS.replace("front", f"front_{k}")
        (folder / "views.yaml").write_text(views)
    fit = scenes, "--passes", "6", "-o", tmp_path / "fields", "--frames"
    assert run(*fit, "0:1") == 0
    assert run(*fit, "1:2") == 0
    capsys.readouterr()
    assert run(*fit, "all") == 0
    assert "2 of 2 frames are done" in capsys.readouterr().err


def test_a_frame_has_one_view(tmp_path, capsys):
    scenes = animate(tmp_path / "rolling")
    frames = scenes, "--field", tmp_path, "--frames", "all"
    assert run(*frames, "--orbit", "5", command="render") == 2
    assert "--frames and --orbit: are mutually exclusive" in capsys.readouterr().err
    assert run(*frames, "--view", "front", "--view", "back", command="render") == 2
    assert "--view is given 2 times" in capsys.readouterr().err


def test_folders_of_frames_share_their_cameras(tmp_path, small, capsys):
    scenes, folders = animate(tmp_path / "rolling"), tmp_path / "folders"
    for k in range(2):
        (folders / f"{k}").mkdir(parents=True)
        (scenes / f"frame_000{k}.xml").rename(folders / f"{k}" / "scene.xml")
    (scenes / "views.yaml").rename(folders / "views.yaml")
    frames = folders, "--frames", "all"
    assert run(*frames, "--passes", "6", "-o", tmp_path / "fields") == 0
    assert f"cameras: from {folders}" in "".join(capsys.readouterr().err.split("\n"))
    shot = *frames, "--field", tmp_path / "fields", "--view", "front", "--size", "16"
    assert run(*shot, "-o", tmp_path / "pictures", command="render") == 0


@pytest.mark.parametrize(
    ("option", "value"), [("--target-psnr", "30"), ("--continue", "a.safetensors")]
)
def test_what_frames_do_not_have_is_said(tmp_path, capsys, option, value):
    assert run(tmp_path, "--frames", "all", option, value) == 2
    assert f"--frames and {option}: are mutually exclusive" in capsys.readouterr().err
