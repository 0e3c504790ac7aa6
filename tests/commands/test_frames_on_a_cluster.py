"""Frames of an animation on a Ray cluster of two machines: their fields and their pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from gpf import fit_frames
from gpf.commands.frame_fit import Stretch, cut_chunks, find_stretches
from gpf.commands.workers import pack_field, unpack_field
from gpf.field.io import load_field
from gpf.fitting.frames import Frame
from gpf.scene.frames import scene_frames
from gpf.scene.load import load_frame
from gpf.scene.transforms import read_sensors
from tests.commands.test_fit_frames import animate, run
from tests.small_fit import assert_same_gaussians, make_small

PROJECT = Path(__file__).parents[2]
FIT = "--passes", "6", "--frames", "all"
RAY = "--executor", "ray"
PICTURES = ("--frames", "all", "--size", "24", "--spp", "2", "--aovs", "depth,normal", "--mp4")


def small_worker() -> None:
    """Let the fits of a worker's process be small."""
    make_small(pytest.MonkeyPatch(), passes=30, steps=60, paths=5_000)


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    """A cluster on this machine, which runs two tasks at a time."""
    ray = pytest.importorskip("ray")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setattr("gpf.core.cluster._cores_of_machines", lambda _: [1.0, 1.0])
        patch.setattr("gpf.commands.fit_frames.ROWS", 32)
        make_small(patch, passes=30, steps=60, paths=5_000)
        environment = {
            "env_vars": {"PYTHONPATH": str(PROJECT)},
            "worker_process_setup_hook": f"{__name__}.{small_worker.__name__}",
        }
        ray.init(
            num_cpus=2,
            include_dashboard=False,
            log_to_driver=False,
            configure_logging=False,
            runtime_env=environment,
        )
        yield
        ray.shutdown()


@pytest.fixture(scope="module")
def rolling(cluster, tmp_path_factory) -> Path:
    """A folder with the scenes of four frames, and their fields, which the cluster has fitted."""
    folder = tmp_path_factory.mktemp("rolling")
    scenes = animate(folder / "scenes", frames=4)
    assert run(scenes, *FIT, *RAY, "-o", folder / "fields") == 0
    return folder


def fields_of(folder: Path) -> list[Path]:
    return [folder / "fields" / f"frame_{k:04d}.safetensors" for k in range(4)]


@pytest.mark.slow
def test_chunks_begin_with_the_first_frame(rolling, capsys):
    frames, files = scene_frames(rolling / "scenes"), fields_of(rolling)
    sensors, _ = read_sensors(rolling / "scenes" / "views.yaml", 32)
    first = Frame(load_frame(frames[0]), load_field(files[0]))
    for number in (1, 2):  # one begins the first chunk, the other the second
        (field,) = fit_frames([load_frame(frames[number])], sensors, passes=6, before=first)
        assert_same_gaussians(load_field(files[number]), unpack_field(pack_field(field)))
    made = {file: file.stat().st_mtime_ns for file in files}
    field = load_field(files[1])
    for words in (RAY, ()):
        files[1].unlink()
        capsys.readouterr()
        assert run(rolling / "scenes", *FIT, *words, "-o", rolling / "fields") == 0
        assert "3 of 4 frames are done" in capsys.readouterr().err
        assert_same_gaussians(load_field(files[1]), field)
    assert [file for file in files if made[file] != file.stat().st_mtime_ns] == [files[1]]


@pytest.mark.slow
def test_pictures_of_a_cluster_are_those_of_one_machine(rolling, capsys):
    asked = rolling / "scenes", "--field", rolling / "fields", *PICTURES
    assert run(*asked, "-o", rolling / "here", command="render") == 0
    assert run(*asked, "-o", rolling / "there", *RAY, command="render") == 0
    assert "4 pictures" in capsys.readouterr().err
    here = sorted(file.name for file in (rolling / "here").iterdir())
    assert here == sorted(file.name for file in (rolling / "there").iterdir())
    assert {"film.mp4", "points.ply", "frame_0003_depth.npy", "frame_0003.exr"} < {*here}
    for name in here:
        assert (rolling / "here" / name).read_bytes() == (rolling / "there" / name).read_bytes()
    (rolling / "there" / "frame_0001.exr").unlink()
    (rolling / "there" / "frame_0002_normal.png").unlink()
    assert run(*asked, "-o", rolling / "there", *RAY, command="render") == 0
    said = capsys.readouterr().err
    assert "1 picture," in said and "3 already done" in said
    for name in here:
        assert (rolling / "here" / name).read_bytes() == (rolling / "there" / name).read_bytes()


@pytest.mark.slow
def test_what_a_worker_says_is_told(cluster, tmp_path, capsys):
    scenes, fields = animate(tmp_path / "scenes", frames=3), tmp_path / "fields"
    ball = '"sphere"><point name="center" x="1" y="1" z="0.3"/><float name="radius" value="0.2"/>'
    for number, shape in ((1, ball), (2, '"ply"><string name="filename" value="none.ply"/>')):
        file = scenes / f"frame_{number:04d}.xml"
        text = file.read_text().replace("</scene>", f"<shape type={shape}</shape></scene>")
        file.write_text(text)
    assert run(scenes, *FIT[:-1], "0:2", *RAY, "-o", fields) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "frame_0001: These shapes have no counterpart in the frame before" in said
    assert run(scenes, *FIT, *RAY, "-o", fields) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert f"{file}:" in said and f"refers to {scenes}/none.ply, which does not exist" in said
    assert sorted(file.name for file in fields.glob("*.*")) == [
        "frame_0000.safetensors",
        "frame_0001.safetensors",
    ]


def test_stretches_of_missing_frames():
    assert find_stretches([0, 1, 2, 5, 6]) == [Stretch(0, 3, None), Stretch(5, 7, 4)]
    chunks = cut_chunks(7, 2)
    assert chunks == {1, 4}
    whole = [Stretch(0, 1, None), Stretch(1, 4, 0), Stretch(4, 7, 0)]
    assert find_stretches(range(7), chunks) == whole
    assert find_stretches([2, 3, 4, 6], chunks) == [
        Stretch(2, 4, 1),
        Stretch(4, 5, 0),
        Stretch(6, 7, 5),
    ]
    assert cut_chunks(3, 8) == {1, 2}


def test_one_field_is_not_spread(tmp_path, capsys):
    assert run(tmp_path, *RAY) == 2
    assert "--executor ray: needs --frames" in capsys.readouterr().err
    assert run(tmp_path, "--frames", "all", "--cluster", "head:10001") == 2
    assert "--cluster: needs `--executor ray`" in capsys.readouterr().err
