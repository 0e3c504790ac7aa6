"""The add-on in Blender: render, move the camera, stop, and fail."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from gpf.commands.addon import write_addon
from gpf.core.errors import UserError
from tests.blender.test_against_cycles import HERE, PYTHON, run

PROJECT = Path(__file__).parents[2]


def test_the_folder_is_not_replaced(tmp_path):
    write_addon(tmp_path / "new" / "photon_field", overwrite=False)
    assert len(list((tmp_path / "new" / "photon_field").iterdir())) == 3
    with pytest.raises(UserError, match="already exists"):
        write_addon(tmp_path / "new" / "photon_field", overwrite=False)
    write_addon(tmp_path / "new" / "photon_field", overwrite=True)


@pytest.fixture
def blender(tmp_path):
    """Render the room with the add-on; what the script tells, and the channels of the picture."""
    if PYTHON is None:
        pytest.skip("no Blender: gpf blender-install")
    write_addon(tmp_path / "photon_field", overwrite=False)
    run("made.py", "room", tmp_path / "room.blend")

    def render(what: str) -> tuple[dict, dict[str, np.ndarray]]:
        out = tmp_path / "picture.exr"
        words = [tmp_path / "photon_field", tmp_path / "room.blend", out, what]
        done = subprocess.run(
            [str(PYTHON), str(HERE / "with_addon.py"), *map(str, words)],
            capture_output=True,
            text=True,
            timeout=500,
            env=os.environ | {"GPF_TESTED": str(PROJECT), "XDG_CACHE_HOME": str(tmp_path / "c")},
        )
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        told = json.loads(done.stdout.strip().splitlines()[-1])
        channels: dict[str, np.ndarray] = {}
        if out.exists():
            for part in OpenEXR.File(str(out), separate_channels=True).parts:  # one for each pass
                found = part.channels.items()
                channels |= {name.partition(".")[2]: c.pixels for name, c in found}
        return told, channels

    return render


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_camera_that_moves_needs_no_other_field(blender):
    told, channels = blender("twice")
    assert told["same field"] and told["new field"] and not told["left"]
    names = [*(f"Combined.{c}" for c in "RGBA"), "Depth.Z", *(f"Normal.{c}" for c in "XYZ")]
    names += [*(f"Albedo.{c}" for c in "RGB"), "Error.X"]
    assert {*names} <= {*channels}
    assert channels["Combined.R"].shape == (64, 96)
    assert channels["Depth.Z"].min() > 0.5 and channels["Depth.Z"].max() < 10
    # The left wall is red, and the floor faces upwards.
    left = {c: channels[f"Albedo.{c}"][20:40, 2].mean() for c in "RGB"}
    assert left["R"] > 3 * left["G"]
    assert np.median(channels["Normal.Z"][-3:]) > 0.95


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_fit_that_is_stopped_is_kept_and_shows_what_gpf_render_shows(blender, tmp_path):
    told, channels = blender("stop")
    assert told["seconds"] < 300
    words = ["render", tmp_path / "room.blend", "--field", told["field"], "--size", "96x64"]
    words += ["--spp", 16, "--aovs", "depth,albedo", "-o", tmp_path / "pictures"]
    done = subprocess.run(
        [sys.executable, "-m", "gpf", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ
        | {"PYTHONPATH": str(PROJECT), "XDG_CACHE_HOME": str(tmp_path / "c")}
        | {"GPF_BLENDER": str(PYTHON)},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (file,) = (tmp_path / "pictures").glob("*.exr")
    ours = OpenEXR.File(str(file), separate_channels=True).channels()
    pairs = {c: f"Combined.{c}" for c in "RGB"} | {f"albedo.{c}": f"Albedo.{c}" for c in "RGB"}
    for name, theirs in (pairs | {"depth.V": "Depth.Z"}).items():
        a, b = ours[name].pixels, channels[theirs]
        # Other random numbers; the noise is 1 %.
        assert np.abs(a - b).mean() < 0.02 * a.mean(), name
        assert b.mean() == pytest.approx(a.mean(), rel=0.003), name


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_an_error_is_shown_in_words(blender):
    told, channels = blender("fail")
    assert "no such luck" in told["error"] and not channels
