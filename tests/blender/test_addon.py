"""The add-on in Blender: render, move the camera, stop, and fail."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from gpf.commands.addon import write_addon
from gpf.core.errors import UserError
from gpf.field.io import read_field
from tests.blender.test_against_cycles import HERE, PYTHON, run

PROJECT = Path(__file__).parents[2]


def test_the_file_is_not_replaced(tmp_path):
    file = tmp_path / "new" / "photon_field.zip"
    write_addon(file, overwrite=False)
    assert len(zipfile.ZipFile(file).namelist()) == 3
    with pytest.raises(UserError, match="already exists"):
        write_addon(file, overwrite=False)
    write_addon(file, overwrite=True)


def test_folders_are_never_replaced(tmp_path):
    """Such as that of another add-on."""
    (tmp_path / "theirs.zip").mkdir()
    (tmp_path / "theirs.zip" / "blender_manifest.toml").write_text("theirs")
    with pytest.raises(UserError, match=r"theirs\.zip"):
        write_addon(tmp_path / "theirs.zip", overwrite=True)
    with pytest.raises(UserError, match="not the name of a zip file"):
        write_addon(tmp_path / "theirs", overwrite=True)
    assert (tmp_path / "theirs.zip" / "blender_manifest.toml").read_text() == "theirs"


@pytest.fixture
def blender(tmp_path):
    """Render the room with the add-on, as Blender installs it; what the script tells."""
    if PYTHON is None:
        pytest.skip("no Blender: gpf blender-install")
    write_addon(tmp_path / "photon_field.zip", overwrite=False)
    run("made.py", "room", tmp_path / "room.blend")

    def render(what: str) -> dict:
        words = [tmp_path / "photon_field.zip", tmp_path / "room.blend", tmp_path, what]
        done = subprocess.run(
            [str(PYTHON), str(HERE / "with_addon.py"), *map(str, words)],
            capture_output=True,
            text=True,
            timeout=900,
            env=os.environ
            | {"GPF_TESTED": str(PROJECT), "XDG_CACHE_HOME": str(tmp_path / "c")}
            | {"BLENDER_USER_RESOURCES": str(tmp_path / "b")},
        )
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        assert not (tmp_path / "c" / "gpf").exists()  # each render would leave a scene
        return json.loads(done.stdout.strip().splitlines()[-1])

    return render


def channels(file: Path) -> dict[str, np.ndarray]:
    """The channels of a picture."""
    found: dict[str, np.ndarray] = {}
    for part in OpenEXR.File(str(file), separate_channels=True).parts:  # one for each pass
        found |= {name.partition(".")[2]: c.pixels for name, c in part.channels.items()}
    return found


@pytest.mark.slow
@pytest.mark.timeout(1000)
def test_a_field_is_made_anew_only_where_it_must_be(blender, tmp_path):
    told = blender("often")
    # whole, region, moved, brighter, grouped
    assert told["new"] == [True, False, False, True, True] and not told["left"]
    assert read_field(Path(told["field"])).lights
    whole, region = (channels(tmp_path / f"{name}.exr") for name in ("whole", "region"))
    names = [*(f"Combined.{c}" for c in "RGBA"), "Depth.Z", *(f"Normal.{c}" for c in "XYZ")]
    names += [*(f"Albedo.{c}" for c in "RGB"), "Error.X"]
    assert {*names} <= {*whole}
    assert whole["Combined.R"].shape == (64, 96)
    assert whole["Depth.Z"].min() > 0.5 and whole["Depth.Z"].max() < 10
    # The left wall is red, and the floor faces upwards.
    left = {c: whole[f"Albedo.{c}"][20:40, 2].mean() for c in "RGB"}
    assert left["R"] > 3 * left["G"]
    assert np.median(whole["Normal.Z"][-3:]) > 0.95
    # Columns 24 to 71, rows 6 to 24 from below.
    part = np.s_[64 - 25 : 64 - 6, 24:72]
    for name in ("Combined.R", "Albedo.R", "Depth.Z"):
        error = np.abs(region[name][part] - whole[name][part]).mean()
        assert error < 0.03 * whole[name].mean(), name


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_region_is_where_blender_has_it(blender, tmp_path):
    """Also where the size of the picture is rounded; every other one is cropped."""
    blender("borders")
    sizes = [(37, 55), (37, 37), (128, 192), (72, 44)]
    for k, (height, width) in enumerate(sizes):
        found = channels(tmp_path / f"border_{k}.exr")
        assert found["Depth.Z"].shape == (height, width), k
        rows, columns = np.nonzero(found["Combined.A"])
        if k % 2:
            assert found["Combined.A"].min() == 1
            rows, columns = rows + found["Depth.Z"][0, 0], columns + found["Combined.R"][0, 0]
        shown = found["Combined.A"] > 0
        np.testing.assert_array_equal(found["Combined.R"][shown], columns)
        np.testing.assert_array_equal(found["Depth.Z"][shown], rows)


@pytest.mark.slow
@pytest.mark.timeout(1000)
def test_a_fit_that_is_stopped_goes_on_and_shows_what_gpf_render_shows(blender, tmp_path):
    told = blender("stop")
    assert told["seconds"] < 300 and told["new"] == [True, False]
    stopped, last = (read_field(Path(f)) for f in (tmp_path / "stopped.safetensors", told["field"]))
    assert stopped.record["fitted"] < told["seconds"]
    assert last.record["fitted"] == pytest.approx(told["seconds"] + 2, rel=1e-4)
    assert last.record["passes"] >= stopped.record["passes"]
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
    shown = channels(tmp_path / "picture.exr")
    pairs = {c: f"Combined.{c}" for c in "RGB"} | {f"albedo.{c}": f"Albedo.{c}" for c in "RGB"}
    for name, theirs in (pairs | {"depth.V": "Depth.Z"}).items():
        a, b = ours[name].pixels, shown[theirs]
        # Other random numbers; the noise is 1 %.
        assert np.abs(a - b).mean() < 0.02 * a.mean(), name
        assert b.mean() == pytest.approx(a.mean(), rel=0.003), name


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_an_error_is_shown_in_words(blender, tmp_path):
    assert "no such luck" in blender("fail")["error"] and not (tmp_path / "picture.exr").exists()
