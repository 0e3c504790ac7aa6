"""What cannot be imported is told in words, and nothing is left of the attempt."""

from __future__ import annotations

import gc
import re
import stat
import zipfile
from pathlib import Path

import pytest

from gpf.core.errors import UserError
from gpf.scene.views import SceneViews
from stages.importing import sources
from stages.importing.importer import import_scene
from tests.stages.importing.foreign_scene import LIGHT, MESH, SCENE, bring, files_of, pack


def assert_refused(path: Path, root: Path, words: str, name: str = "room") -> UserError:
    """The import ends with these words, names no temporary file and leaves nothing behind."""
    before = sorted(root.iterdir())
    with pytest.raises(UserError, match=words) as caught:
        bring(path, root, name)
    assert ".gpf-partial-" not in str(caught.value)
    assert sorted(root.iterdir()) == before
    return caught.value


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('wedge"/>', 'lost"/>', r"scene\.xml:30: refers to .*Their Room/models/lost\.ply, which "
         r"does not exist\. Put it there"),
        ("$mesh.ply", "models\\wedge.ply", r"scene\.xml:30: refers to .* Separate folders with /"),
        ("wood.png", "lost.png", r"scene\.xml:21: refers to .*lost\.png, which does not exist"),
        ("green.spd", "red.spd", r"scene\.xml:31: refers to .*red\.spd, which does not exist"),
        ("parts/light", "parts/dark", r"scene\.xml:17: refers to .*parts/dark\.xml, which does no"),
        ('value="textures"', 'value="none"', r"scene\.xml:6: refers to .*none, which does not"),
        ("$mesh.ply", "models", r"scene\.xml:30: refers to .*models, which is not a file"),
        ("$mesh.ply", "/etc/hostname", r"scene\.xml:30: refers to /etc/hostname by an absolute p"),
        ("$mesh.ply", "../outside.ply", r"scene\.xml:30: refers to \.\./outside\.ply, which is out"
         r"side the scene's folder .*Their Room\. Copy it into the folder"),
        ("$mesh.ply", "models/../../outside.ply", r"scene\.xml:30: .*outside the scene's f"),
        ("$mesh.ply", "link.ply", r"scene\.xml:30: refers to link\.ply, a link to .*outside\.ply, "
         r"which is outside the scene's folder"),
        ("$mesh.ply", "scene.xml", r"scene\.xml:30: refers to scene\.xml, a name "
         r"that is reserved"),
        ('<scene version="3.0.0">', '<scene version="0.6.0"><film type="ldrfilm"/>', r"scene\.xml: "
         r"does not load: .*Their Room/scene\.xml \(line 2, .*ldrfilm.* In old scenes, Mitsuba 3 "),
        ('<scene version="3.0.0">', "<scene>", r"scene\.xml:2: <scene> has no version\. Add vers"
         r'ion="3\.0\.0", or "0\.6\.0" if parameter names look like toWorld'),
        ('<scene version="3.0.0">', '<scene version="3">', r"scene\.xml:2: has the version '3'"),
        ('type="perspective"', 'type="orthographic"', r"scene\.xml:7: the sensor is of type orthogr"
         r"aphic\. Views need one of type perspective or thinlens"),
        ('type="dielectric"', 'type="dialectric"', r"scene\.xml: does not load: .*Their Room/scene"
         r"\.xml \(line 35.*dialectric"),
        ("</scene>", "</scen>", r"scene\.xml: does not parse: mismatched tag: line 37"),
        ("</scene>", '<emitter type="timed_sunsky"/></scene>', r"scene\.xml:37: has an emitter of t"
         r"ype timed_sunsky, which cannot emit photons"),
        ("0, 0.25, 0", "0.5, 9, 4.5", r"scene\.xml: its sensor sees no d"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_scene_file_is_told_with_its_line(original, root, old, new, words):
    (original.parent / "outside.ply").write_text(MESH)
    (original / "link.ply").symlink_to(original.parent / "outside.ply")
    assert SCENE.count(old) == 1
    (original / "scene.xml").write_text(SCENE.replace(old, new))
    assert_refused(original, root, words)


def test_a_material_that_cannot_be_traced_is_told(original, root):
    bump = '<bsdf type="bumpmap"><texture type="checkerboard"/><bsdf type="diffuse"/></bsdf>'
    (original / "scene.xml").write_text(SCENE.replace('<bsdf type="dielectric" id="Glass"/>', bump))
    assert_refused(
        original,
        root,
        r"scene\.xml: cannot be traced: .*eval_1_grad.* Give the bumpmap a bitmap",
    )
    # The error's traceback holds the scene, and Dr.Jit traces through all that exist.
    gc.collect()


def test_a_scene_needs_a_sensor_of_its_own(original, root):
    sensor = re.search(r"(?s)<sensor.*</sensor>", SCENE)[0]
    (original / "scene.xml").write_text(SCENE.replace(sensor, ""))
    assert_refused(
        original, root, r"scene\.xml:2: the scene has no sensor\. Add a perspective <sen"
    )
    batch = f'<sensor type="batch">{sensor}</sensor>'
    (original / "scene.xml").write_text(SCENE.replace(sensor, batch))
    assert_refused(
        original, root, r"scene\.xml: has no perspective sensor at the top level of .* Move the se"
    )


def test_a_light_that_reaches_nothing_is_told(original, root):
    sensor = re.search(r"(?s)<sensor.*</sensor>", SCENE)[0]
    sizes = '<default name="resx" value="9"/><default name="resy" value="6"/>'
    floor = '<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/>'
    lamp = '<emitter type="point"><point name="position" x="0" y="-1" z="0"/></emitter>'
    (original / "scene.xml").write_text(
        f'<scene version="3.0.0">{sizes}{sensor}{floor}</transform></shape>{lamp}</scene>'
    )
    assert_refused(original, root, r"scene\.xml: none of 2,000 photon paths reached a diffuse surf")


def test_what_mitsuba_does_not_take_in_an_old_include_is_told_with_its_line(original, root):
    old = (
        LIGHT.replace("3.0.0", "0.5.0")
        .replace("<emitter", "<luminaire")
        .replace("/emitter", "/luminaire")
    )
    (original / "parts/light.xml").write_text("\n" + old)
    assert_refused(original, root, r"parts/light\.xml \(line 3, .*<luminaire>.* In old scenes, Mit")


def test_a_shape_is_no_scene(original, root):
    (original / "scene.xml").write_text('<shape version="3.0.0" type="sphere"/>')
    assert_refused(original, root, r"scene\.xml:1: begins with <shape>\. Name a file that begins w")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Their Room", r"name 'Their Room': is not a lower-case letter .* Try their_room\."),
        ("_x", r"Try x\."),
        ("../up", r"Try up\."),
        ("", r"Try scene_of_mine\."),
        ("123", r"name '123': is not a lower-case letter .* Try scene_123\."),
        ("true", r"name 'true': is reserved"),
        ("tables", r"name 'tables': is reserved"),
        ("taken", r"name 'taken': is taken: .*scenes/taken exists\. Choose another name"),
    ],
)
def test_names_that_do_not_do(original, root, name, words):
    (root / "taken").mkdir()
    assert_refused(original, root, words, name)


def test_several_files_are_listed_and_none_is_told(original, root, tmp_path):
    (original / "scene.xml").rename(original / "a.xml")
    (original / "B.XML").write_text(SCENE)
    several = r"has several XML files \(B\.XML, a\.xml\)\. Give the path of one of them"
    assert_refused(original, root, rf"Their Room: {several}")
    archive = pack(original, tmp_path / "room.zip")
    assert_refused(
        archive, root, r"room\.zip: has several XML files .* Unpack it and give the path of one"
    )
    assert_refused(original / "models", root, r"models: has no XML file\. Give a folder with")
    assert_refused(tmp_path / "nowhere", root, r"nowhere: does not exist\. Check the path")
    assert_refused(original / "green.spd", root, r"green\.spd: is not a folder, an XML file")
    bring(original / "a.xml", root)


def test_messages_about_archives_name_the_archive(original, root, tmp_path):
    (original / "models/wedge.ply").unlink()
    archive = pack(original, tmp_path / "room.zip")
    error = assert_refused(archive, root, r"refers to .*, which does not exist")
    assert error.where == f"{archive}/Their Room/scene.xml:30"
    assert error.what.startswith(f"refers to {archive}/Their Room/models/wedge.ply")
    (original / "models/wedge.ply").write_text("solid")
    pack(original, archive)
    error = assert_refused(archive, root, r"does not load")
    assert error.where == f"{archive}/Their Room/scene.xml"
    assert f"{archive}/Their Room/scene.xml (line 29" in error.what


@pytest.mark.parametrize(
    ("member", "words"),
    [
        ("/evil.xml", r"its member '/evil\.xml' has an absolute path"),
        ("C:\\evil.xml", r"has an absolute path"),
        ("\\\\server\\evil.xml", r"has an absolute path"),
        ("room/../../evil.xml", r"its member 'room/\.\./\.\./evil\.xml' leads out of the archive"),
        ("room\\..\\..\\evil.xml", r"leads out of the archive"),
        ("../evil.xml", r"leads out of the archive"),
    ],
)
def test_archives_that_reach_out_are_refused(original, root, tmp_path, member, words):
    archive = pack(original, tmp_path / "room.zip")
    with zipfile.ZipFile(archive, "a") as opened:
        opened.writestr(member, "<scene/>")
    before = files_of(tmp_path)
    assert_refused(archive, root, rf"room\.zip: .*{words}")
    assert files_of(tmp_path) == before


def test_links_in_archives_are_refused(original, root, tmp_path):
    archive = pack(original, tmp_path / "room.zip")
    link = zipfile.ZipInfo("Their Room/models/passwords.ply")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(archive, "a") as opened:
        opened.writestr(link, "/etc/passwd")
    assert_refused(archive, root, r"member 'Their Room/models/passwords\.ply' is a link or another")


def test_archives_that_unpack_to_too_much_are_refused(original, root, tmp_path, monkeypatch):
    archive = pack(original, tmp_path / "room.zip")
    monkeypatch.setattr(sources, "MOST_FILES", 5)
    assert_refused(archive, root, r"room\.zip: has 10 members, .*; the limits are 5 and 4 GiB\. If")
    monkeypatch.undo()
    with zipfile.ZipFile(archive, "a", zipfile.ZIP_DEFLATED) as opened:
        opened.writestr("zeros", bytes(2**20))
    monkeypatch.setattr(sources, "MOST_BYTES", 2**20)
    assert_refused(archive, root, r"the limits are 10,000 and")


def test_damaged_archives_are_told(original, root, tmp_path):
    archive = pack(original, tmp_path / "room.zip")
    data = archive.read_bytes()
    archive.write_bytes(data.replace(b"Do as you", b"Pay for it"[:9]))
    assert_refused(archive, root, r"room\.zip: cannot be unpacked: Bad CRC-32.*Pack it again")
    archive.write_bytes(data[: len(data) // 2])
    assert_refused(archive, root, r"room\.zip: is not a folder, an XML file, a zip")


def test_damaged_bzip2_is_told(original, root, tmp_path):
    """The only method that raises a plain OSError."""
    archive = tmp_path / "room.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_BZIP2) as opened:
        opened.write(original / "scene.xml", "scene.xml")
    data = archive.read_bytes()
    archive.write_bytes(data.replace(b"BZh9", b"BZh0"))
    assert_refused(archive, root, r"room\.zip: cannot be unpacked: Invalid data stream\. Pack it")


def test_whatever_interrupts_leaves_nothing_behind(original, root):
    def interrupt(*_: object) -> SceneViews:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_scene(original, "room", interrupt, root, photons=2000)
    assert list(root.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_told(original, tmp_path):
    with pytest.raises(UserError, match=r"nowhere/room: could not be created \(.*Free some disk"):
        bring(original, tmp_path / "nowhere")


@pytest.mark.parametrize("way", ["place", "name"])
def test_members_that_the_system_refuses_are_told(original, root, tmp_path, way):
    archive = pack(original, tmp_path / "room.zip")
    if way == "name":
        with zipfile.ZipFile(archive, "a") as opened:
            opened.writestr("x" * 300, "text")
    else:  # of the first member: far before the beginning of the file
        data = bytearray(archive.read_bytes())
        at = data.find(b"PK\x05\x06") + 16  # where the list of members begins, as the end says
        data[at : at + 4] = (2**31).to_bytes(4, "little")
        archive.write_bytes(data)
    assert_refused(archive, root, r"room\.zip: cannot be unpacked: .*Pack it again")
