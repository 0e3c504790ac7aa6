"""An import writes below its own folder only, whatever way a scene file names its files."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import pytest

from gpf.core.errors import UserError
from gpf.scene.load import load_scene
from gpf.scene.snapshot import snapshot_scene
from tests.stages.importing.foreign_scene import LIGHT, MESH, SCENE, bring, pack

VIEWS = """\
views:
  train: [{name: front, origin: [0.5, 1.5, 4], target: [0, 0, 0], fov: 40}]
"""


def contents_of(folder: Path) -> dict[str, bytes | None]:
    """All folders below a folder, and all files with their contents."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


def assert_refused(path: Path, root: Path) -> None:
    """The import ends in words, and no file or folder around it is changed."""
    around = root.parents[1]
    before = contents_of(around)
    with pytest.raises(UserError, match=r"scene\.xml:30: refers to .*leads out of the .*folder"):
        bring(path, root)
    assert contents_of(around) == before


@pytest.mark.parametrize("levels", [1, 2, 3, 4])
def test_a_way_back_in_by_the_folders_own_name_is_refused(original, root, tmp_path, levels):
    """From where the copy stands, the same way leads to other files."""
    theirs = tmp_path / "gpf/baselines/denoised"
    shutil.copytree(original, theirs)
    names = ["gpf", "baselines", "denoised", "wedge.ply"]
    way = "/".join([*[".."] * levels, *([tmp_path.name, *names][-1 - levels :])])
    shutil.move(theirs / "models/wedge.ply", theirs / "wedge.ply")
    for place in ("gpf/baselines/denoised", "scenes/denoised", "scenes/baselines/denoised"):
        (root.parent / place).mkdir(parents=True)
        (root.parent / place / "wedge.ply").write_text("ours")
    (theirs / "scene.xml").write_text(SCENE.replace("$mesh.ply", way))
    assert_refused(theirs, root)


def test_a_way_through_another_scene_is_refused_in_archives(original, root, tmp_path):
    ours = root / "veach_ajar/meshes"
    ours.mkdir(parents=True)
    (ours / "door.ply").write_text("ours")
    theirs = original.rename(tmp_path / "meshes")
    (theirs / "door.ply").write_text(MESH)
    text = SCENE.replace("$mesh.ply", "../../veach_ajar/meshes/door.ply")
    (theirs / "scene.xml").write_text(text)
    pack(theirs, tmp_path / "room.zip")
    with zipfile.ZipFile(tmp_path / "room.zip") as plain:
        members = {f"veach_ajar/{name}": plain.read(name) for name in plain.namelist()}
    with zipfile.ZipFile(tmp_path / "room.zip", "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    assert_refused(tmp_path / "room.zip", root)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<path value="textures"/>', '<path value="../Their Room/textures"/>'),
        ('"parts/light.xml"', '"../Their Room/parts/light.xml"'),
        ('"wood.png"', '"../../Their Room/textures/wood.png"'),
        ('"green.spd"', '"models/../../Their Room/green.spd"'),
    ],
)
def test_folders_includes_textures_and_spectra_are_refused_so_too(
    original, root, tmp_path, old, new
):
    (original / "scene.xml").write_text(SCENE.replace(old, new))
    before = contents_of(tmp_path)
    with pytest.raises(UserError, match=r"scene\.xml:\d+: refers to .*leads out of the .*folder"):
        bring(original, root)
    assert contents_of(tmp_path) == before


def test_ways_that_stay_inside_are_imported(original, root, tmp_path):
    """Also names with dots in them, and folders that serve the way alone."""
    (original / "nothing").mkdir()
    (original / "a..b").mkdir()
    (original / "models/wedge.ply").rename(original / "a..b/..wedge.ply")
    (original / "parts/light.xml").write_text(LIGHT)
    text = SCENE.replace("$mesh.ply", "nothing/../a..b/..wedge.ply")
    text = text.replace('"wood.png"', '"../textures/../..wood.png"')
    (original / "textures/wood.png").rename(original / "..wood.png")
    (original / "scene.xml").write_text(text)
    bring(original, root)
    assert (root / "room/a..b/..wedge.ply").is_file()
    assert (root / "room/..wood.png").is_file()
    original.rename(tmp_path / "gone")
    assert len(load_scene("room", root=root).shapes()) == 3
    snapshot_scene("room", tmp_path / "frozen", root)
    assert (tmp_path / "frozen/a..b/..wedge.ply").is_file()


# --- the copy that the pipeline works with --------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"$mesh.ply"', '"../room/models/wedge.ply"'),
        ('"$mesh.ply"', '"../../scenes/room/models/wedge.ply"'),
        ('<path value="textures"/>', '<path value="textures"/><path value="../../else/where"/>'),
        ('<path value="textures"/>', '<path value="textures"/><path value="../room/parts"/>'),
    ],
)
def test_a_snapshot_writes_below_its_folder_only(original, tmp_path, old, new):
    home = tmp_path / "scenes/room"
    home.parent.mkdir()
    original.rename(home)
    (home / "views.yaml").write_text(VIEWS)
    (home / "scene.xml").write_text(SCENE.replace(old, new))
    (tmp_path / "else/where").mkdir(parents=True)
    (tmp_path / "results/room").mkdir(parents=True)
    before = contents_of(tmp_path)
    with pytest.raises(UserError, match=r"scene\.xml:\d+: refers to .*leads out of the .*folder"):
        snapshot_scene("room", tmp_path / "results/room/scene", tmp_path / "scenes")
    assert contents_of(tmp_path) == before


def test_an_absolute_way_into_the_own_folder_is_refused_in_words(original, tmp_path, monkeypatch):
    home = tmp_path / "scenes/room"
    home.parent.mkdir()
    original.rename(home)
    (home / "scene.xml").write_text(SCENE.replace("$mesh.ply", f"{home}/models/wedge.ply"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=r"scene\.xml:30: refers to .*Copy it into the folder"):
        snapshot_scene("room", tmp_path / "frozen", Path("scenes"))


def test_links_in_the_folder_of_a_scene_do_not_lead_elsewhere(original, root, tmp_path):
    """Folders of the copy are folders: a link of the original is followed once."""
    (original / "models").rename(original / "really")
    (original / "models").symlink_to(original / "really")
    bring(original, root)
    assert not (root / "room/models").is_symlink()
    assert (root / "room/models/wedge.ply").read_text() == MESH
