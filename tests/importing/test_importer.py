"""Somebody else's scene becomes one of the project's, or nothing is left of the attempt."""

from __future__ import annotations

import gc
import re
import stat
import zipfile
from io import StringIO
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from rich.console import Console

from gpf.errors import UserError
from gpf.importing import sources
from gpf.importing.description import print_report
from gpf.importing.importer import ImportReport, import_scene
from gpf.importing.report import Material, examine_scene, list_materials
from gpf.pilot import trace_pilot
from gpf.scenes import freeze_scene, list_scenes, load_scene, load_views
from gpf.views import SceneViews, View, ViewSets

ORIGINALS = Path(__file__).parents[3] / "shared/scenes"

SCENE = """\
<?xml version="1.0" encoding="utf-8"?>
<scene version="3.0.0">
    <default name="resx" value="9"/>
    <default name="resy" value="6"/>
    <default name="mesh" value="models/wedge"/>
    <path value="textures"/>
    <sensor type="perspective" id="Main Camera">
        <float name="fov" value="50"/>
        <transform name="to_world">
            <lookat origin="0.5, 1.5, 4" target="0, 0.25, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="$resx"/>
            <integer name="height" value="$resy"/>
        </film>
    </sensor>
    <include filename="parts/light.xml"/>
    <bsdf type="twosided" id="Floor">
        <bsdf type="diffuse">
            <texture name="reflectance" type="bitmap">
                <string name="filename" value="wood.png"/>
            </texture>
        </bsdf>
    </bsdf>
    <shape type="rectangle" id="Ground">
        <transform name="to_world"><rotate x="1" angle="-90"/><scale value="3"/></transform>
        <ref id="Floor"/>
    </shape>
    <shape type="ply" id="Wedge">
        <string name="filename" value="$mesh.ply"/>
        <bsdf type="diffuse" id="Green"><spectrum name="reflectance" filename="green.spd"/></bsdf>
    </shape>
    <shape type="sphere" id="Ball">
        <point name="center" x="1" y="0.5" z="1"/><float name="radius" value="0.4"/>
        <bsdf type="dielectric" id="Glass"/>
    </shape>
</scene>
"""
LIGHT = """\
<scene version="3.0.0">
    <emitter type="point" id="Lamp"><point name="position" x="0" y="3" z="0"/></emitter>
</scene>
"""
MESH = """\
ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
-1 0 0
1 0 0
0 1 -0.5
3 0 1 2
"""


@pytest.fixture
def original(tmp_path) -> Path:
    """A folder with a scene in it, as somebody else would have made it."""
    folder = tmp_path / "Their Room"
    for name in ("parts", "models", "textures"):
        (folder / name).mkdir(parents=True)
    (folder / "scene.xml").write_text(SCENE)
    (folder / "parts/light.xml").write_text(LIGHT)
    (folder / "models/wedge.ply").write_text(MESH)
    (folder / "models/unused.ply").write_text(MESH)
    (folder / "green.spd").write_text("400 0.1\n550 0.8\n700 0.1\n")
    (folder / "LICENSE.txt").write_text("Do as you like.\n")
    texture = np.linspace(0, 1, 4 * 3 * 3, dtype=np.float32).reshape(3, 4, 3)
    mi.util.write_bitmap(str(folder / "textures/wood.png"), texture, write_async=False)
    return folder


@pytest.fixture
def root(tmp_path) -> Path:
    root = tmp_path / "project/scenes"
    root.mkdir(parents=True)
    return root


def place_two(scene: mi.Scene, own: list[View], aspect: float) -> SceneViews:
    """The scene's own cameras, and the first one a step aside."""
    x, y, z = own[0].origin
    aside = own[0].model_copy(update={"name": "aside", "origin": (x - 0.5, y, z)})
    return SceneViews(views=ViewSets(train=tuple(own), novel=(aside,)), aspect=aspect)


def bring(path: Path, root: Path, name: str = "room") -> ImportReport:
    return import_scene(path, name, place_two, root, photons=2000)


def pack(folder: Path, archive: Path) -> Path:
    with zipfile.ZipFile(archive, "w") as opened:
        for file in sorted(folder.rglob("*")):
            opened.write(file, file.relative_to(folder.parent).as_posix())
    return archive


def files_of(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


IMPORTED = [
    "LICENSE.txt",
    "README.md",
    "green.spd",
    "models/wedge.ply",
    "parts/light.xml",
    "scene.xml",
    "textures/wood.png",
    "views.yaml",
]


@pytest.mark.parametrize("kind", ["folder", "xml", "zip"])
def test_a_scene_is_imported_with_all_that_it_refers_to(original, root, tmp_path, kind):
    if kind == "xml":
        path = (original / "scene.xml").rename(original / "room v3.xml")
    else:
        path = original if kind == "folder" else pack(original, tmp_path / "room.zip")
    report = bring(path, root)
    assert report.folder == root / "room"
    assert report.origin == path.name
    assert (root / "room").stat().st_mode & 0o777 == 0o755
    assert [p.name for p in root.iterdir()] == ["room"]
    assert files_of(root / "room") == IMPORTED
    assert (root / "room/scene.xml").read_text() == SCENE
    assert report.files == len(IMPORTED) - 2  # README and views are new
    assert report.warnings == report.scene.warnings == ()


def test_an_imported_scene_is_a_scene_like_the_others(original, root, tmp_path):
    report = bring(original, root)
    original.rename(tmp_path / "gone")  # nothing may depend on where it came from
    assert list_scenes(root) == ["room"]
    views = load_views("room", root)
    assert [view.name for view in (*views.train, *views.novel)] == ["main_camera", "aside"]
    assert views == report.views
    assert views.size(6) == (9, 6)
    assert len(load_scene("room", root=root).shapes()) == 3
    freeze_scene("room", tmp_path / "frozen", root)
    assert files_of(tmp_path / "frozen") == sorted(set(IMPORTED) - {"LICENSE.txt", "README.md"})


def test_the_report_says_what_was_found(original, root):
    report = bring(original, root)
    scene = report.scene
    assert scene.emitters == {"point": 1}
    assert scene.materials == (
        Material("Floor", "twosided diffuse", "queried"),
        Material("Green", "diffuse", "queried"),
        Material("Glass", "dielectric", "traced through"),
    )
    assert scene.size == pytest.approx((6, 1, 6))
    assert scene.diagonal == pytest.approx(np.sqrt(73))
    # The floor fills this part of the directions from a point at a distance of its half width:
    # a face of a cube as seen from its centre, one sixth.
    assert scene.landing == pytest.approx(1 / 6, abs=0.04)
    assert 3 < scene.camera_distance < 6
    assert 0 < scene.initial_radius < 1
    assert 0 < scene.search_radius < 2
    text = StringIO()
    print_report(report, Console(file=text, width=40))
    assert re.search(r"files +6 copied, 0\.0 MB\n", text.getvalue())
    assert re.search(r"emitters +1 point\n", text.getvalue())
    assert re.search(r"queried +twosided diffuse: Floor; diffuse: Green\n", text.getvalue())
    assert re.search(r"traced through +dielectric: Glass\n", text.getvalue())
    assert re.search(r"size +6 × 1 × 6 units, diagonal 8\.544\n", text.getvalue())
    assert re.search(r"views +1 to train, 1 novel, no path\n", text.getvalue())
    readme = (root / "room/README.md").read_text()
    assert "Imported from `Their Room`" in readme
    assert "Licence: see `LICENSE.txt`" in readme
    assert "twosided diffuse: Floor; diffuse: Green" in readme
    assert str(original.parent) not in readme


def test_a_licence_that_is_not_there_is_to_be_filled_in(original, root):
    (original / "LICENSE.txt").unlink()
    bring(original, root)
    assert "Licence: unknown; to be filled in" in (root / "room/README.md").read_text()


def test_their_own_readme_stays(original, root):
    (original / "ReadMe.txt").write_text("Found in an attic.")
    bring(original, root)
    assert (root / "room/ReadMe.txt").read_text() == "Found in an attic."
    assert not (root / "room/README.md").exists()


def test_a_licence_around_the_scenes_folder_counts(original, root, tmp_path):
    (original / "LICENSE.txt").rename(tmp_path / "COPYING")
    archive = pack(original, tmp_path / "room.zip")
    with zipfile.ZipFile(archive, "a") as opened:
        opened.write(tmp_path / "COPYING", "COPYING")
    bring(archive, root)
    assert (root / "room/COPYING").read_text() == "Do as you like.\n"


def test_what_is_left_behind_or_shown_otherwise_is_said(original, root):
    text = SCENE.replace('type="perspective" id="Main Camera"', 'type="thinlens"').replace(
        '<float name="fov" value="50"/>',
        '<float name="fov" value="50"/><float name="aperture_radius" value="0.1"/>'
        '<float name="near_clip" value="4"/>',
    )
    more = (
        '<sensor type="orthographic"/><sensor type="perspective" id="b"><transform name="to_world">'
    )
    more += (
        '<scale x="-1"/><translate z="5" y="1"/><rotate y="1" angle="180"/></transform></sensor>'
    )
    (original / "scene.xml").write_text(text.replace("</scene>", more + "</scene>"))
    (original / "old.xml").write_text(SCENE)
    (original / "views.yaml").write_text("views: {}")
    report = bring(original, root)
    line = SCENE.count("\n")
    said = "\n".join(report.warnings)
    assert "not imported: old.xml (nothing refers to it)" in said
    assert f"the orthographic sensor in line {line} is no camera: left out" in said
    assert "it has 2 cameras" in said
    assert "not imported: views.yaml" in said
    assert "sensor camera has an aperture: views are in focus everywhere" in said
    assert "sensor b shows a mirror image: views show it the right way round" in said
    near = re.search(r"sensor camera leaves out all that is nearer than 4 units.* (\d+)%", said)
    assert near and 5 < int(near[1]) < 60
    assert [view.name for view in report.views.train] == ["camera", "b"]
    for warning in report.warnings:
        assert warning in (root / "room/README.md").read_text()


# --- what is refused ----------------------------------------------------------------------------


def assert_refused(path: Path, root: Path, words: str, name: str = "room") -> UserError:
    """The import ends with these words, names no temporary file and leaves nothing behind."""
    before = sorted(root.iterdir())
    with pytest.raises(UserError, match=words) as caught:
        bring(path, root, name)
    assert ".import-" not in str(caught.value)
    assert sorted(root.iterdir()) == before
    return caught.value


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('wedge"/>', 'lost"/>', r"scene\.xml:30: refers to .*Their Room/models/lost\.ply, which "
         r"does not exist\. Put it there"),
        ("$mesh.ply", "models\\wedge.ply", r"scene\.xml:30: refers to .* Write / for "),
        ("wood.png", "lost.png", r"scene\.xml:21: refers to .*lost\.png, which does not exist"),
        ("green.spd", "red.spd", r"scene\.xml:31: refers to .*red\.spd, which does not exist"),
        ("parts/light", "parts/dark", r"scene\.xml:17: refers to .*parts/dark\.xml, which does no"),
        ('value="textures"', 'value="none"', r"scene\.xml:6: refers to .*none, which does not"),
        ("$mesh.ply", "models", r"scene\.xml:30: refers to .*models, which is no file"),
        ("$mesh.ply", "/etc/hostname", r"scene\.xml:30: refers to /etc/hostname by an absolute p"),
        ("$mesh.ply", "../outside.ply", r"scene\.xml:30: refers to \.\./outside\.ply, which is out"
         r"side of the scene's folder .*Their Room\. Copy it into the folder"),
        ("$mesh.ply", "models/../../outside.ply", r"scene\.xml:30: .*outside of the scene's f"),
        ("$mesh.ply", "link.ply", r"scene\.xml:30: refers to link\.ply, a link to .*outside\.ply, "
         r"which is outside of the scene's folder"),
        ("$mesh.ply", "scene.xml", r"scene\.xml:30: refers to scene\.xml, but .* name is taken"),
        ('<scene version="3.0.0">', '<scene version="0.6.0">', r"scene\.xml:2: is a scene of Mitsub"
         r"a 0\.6 \(version 0\.6\.0\)\. Convert it to Mitsuba 3: .*to_world for toWorld"),
        ('<scene version="3.0.0">', "<scene>", r"scene\.xml:2: <scene> has no version\. Add vers"),
        ('<scene version="3.0.0">', '<scene version="3">', r"scene\.xml:2: has the version '3'"),
        ('type="perspective"', 'type="orthographic"', r"scene\.xml:7: the sensor is of type orthogr"
         r"aphic\. Views need one of type perspective or thinlens"),
        ('type="dielectric"', 'type="dialectric"', r"scene\.xml: does not load: .*Their Room/scene"
         r"\.xml \(line 35.*dialectric"),
        ('type="dielectric"', 'type="principled"', r"scene\.xml: has materials of type principled"),
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
        r"scene\.xml: light cannot be traced in it: .*eval_1_grad.* A bumpmap needs a bitmap",
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
        original, root, r"scene\.xml: has no perspective sensor of its own\. Take the se"
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


def test_an_include_of_mitsuba_0_6_is_told_with_its_own_line(original, root):
    (original / "parts/light.xml").write_text("\n" + LIGHT.replace("3.0.0", "0.5.0"))
    assert_refused(original, root, r"parts/light\.xml:2: is a scene of Mitsuba 0\.6 \(version 0\.5")


def test_a_shape_is_no_scene(original, root):
    (original / "scene.xml").write_text('<shape version="3.0.0" type="sphere"/>')
    assert_refused(original, root, r"scene\.xml:1: begins with <shape>\. Name a file that begins w")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Their Room", r"name 'Their Room': is not a small letter .* instance their_room\."),
        ("_x", r"Take for instance x\."),
        ("../up", r"Take for instance up\."),
        ("", r"Take for instance scene_of_mine\."),
        ("123", r"name '123': is not a small letter .* instance scene_123\."),
        ("true", r"name 'true': means something else already"),
        ("tables", r"name 'tables': means something else already"),
        ("taken", r"name 'taken': is taken: there is .*scenes/taken\. Choose another name"),
    ],
)
def test_names_that_do_not_do(original, root, name, words):
    (root / "taken").mkdir()
    assert_refused(original, root, words, name)


def test_several_files_are_listed_and_none_is_told(original, root, tmp_path):
    (original / "scene.xml").rename(original / "a.xml")
    (original / "B.XML").write_text(SCENE)
    assert_refused(
        original, root, r"Their Room: has several XML files \(B\.XML, a\.xml\)\. Name one of them: "
    )  # fmt: skip
    archive = pack(original, tmp_path / "room.zip")
    assert_refused(archive, root, r"room\.zip: has several XML files .* Unpack it and name one")
    assert_refused(original / "models", root, r"models: has no XML file\. Name a folder with")
    assert_refused(tmp_path / "nowhere", root, r"nowhere: does not exist\. Check the path")
    assert_refused(original / "green.spd", root, r"green\.spd: is neither a folder, nor an XML")
    bring(original / "a.xml", root)


def test_scene_xml_is_preferred_and_rubbish_of_other_systems_ignored(original, root, tmp_path):
    (original / "a.xml").write_text(SCENE)
    archive = pack(original, tmp_path / "room.zip")
    with zipfile.ZipFile(archive, "a") as opened:
        opened.writestr("__MACOSX/Their Room/scene.xml", b"\0")
        opened.writestr("Their Room/._scene.xml", b"\0")
    report = bring(archive, root)
    assert report.warnings == ("not imported: a.xml (nothing refers to it)",)


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
    assert_refused(archive, root, r"room\.zip: does not unpack: Bad CRC-32.*Pack it anew")
    archive.write_bytes(data[: len(data) // 2])
    assert_refused(archive, root, r"room\.zip: is neither a folder, nor an XML file, nor a zip")


def test_whatever_interrupts_leaves_nothing_behind(original, root):
    def interrupt(*_: object) -> SceneViews:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_scene(original, "room", interrupt, root, photons=2000)
    assert list(root.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_told(original, tmp_path):
    with pytest.raises(UserError, match=r"nowhere/room: could not be made \(.*Free some disk"):
        bring(original, tmp_path / "nowhere")


# --- what photon mapping makes of materials and emitters -----------------------------------------


def test_remarks_on_what_behaves_unexpectedly():
    bsdfs = ("polarizer", "circular", "retarder", "pplastic", "hair", "null")
    shapes = {
        f"s{i}": {"type": "sphere", "center": [3 * i, 0, 0], "bsdf": {"type": kind}}
        for i, kind in enumerate(bsdfs)
    }
    shapes["s5"]["interior"] = {"type": "homogeneous", "sigma_t": 2.0}
    floor = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, -3])}
    lamp = {"type": "directionalarea"}
    lit = {"type": "rectangle", "to_world": floor["to_world"].translate([0, 0, 1]), "lamp": lamp}
    lit["to_world"] = lit["to_world"].rotate([1, 0, 0], 180)
    scene = mi.load_dict({"type": "scene", **shapes, "floor": floor, "lit": lit}, optimize=False)
    view = View(name="front", origin=(0, -2, 0), target=(0, 0, -3), fov=40)
    report = examine_scene(scene, view, 1.5, "scene", photons=2000)
    assert report.emitters == {"directionalarea": 1}
    said = "\n".join(report.warnings)
    assert said.startswith("a participating medium: ignored, light passes as if the space were")
    for kind in ("polarizer", "circular", "retarder", "pplastic", "hair", "directionalarea"):
        assert len(re.findall(rf"^{kind}: ", said, flags=re.MULTILINE)) == 1
    uses = {material.kind: material.use for material in report.materials}
    assert uses == {
        "polarizer": "traced through",
        "circular": "traced through",
        "retarder": "traced through",
        "pplastic": "both",
        "hair": "traced through",
        "null": "traced through",
        "diffuse": "queried",
    }


@pytest.mark.parametrize(
    ("kind", "share"), [("null", 1.0), ("polarizer", 0.5), ("circular", 0.5), ("retarder", 1.0)]
)
def test_the_remarks_on_filters_are_true(kind, share):
    from gpf.photon_tracing import record_photons

    down = mi.ScalarTransform4f().look_at([0, 0, 1], [0, 0, 0], [0, 1, 0])
    scene = mi.load_dict(
        {
            "type": "scene",
            "pane": {"type": "rectangle", "bsdf": {"type": kind}},
            "floor": {"type": "disk", "to_world": mi.ScalarTransform4f().translate([0, 0, -1])},
            "lamp": {"type": "spot", "to_world": down, "cutoff_angle": 20},
        },
        optimize=False,
    )
    power = np.array(record_photons(scene, paths=1000, seed=1).power)[0].sum()
    bare = np.array(mi.traverse(scene)["lamp.intensity.value"]).ravel()[0]
    assert bare == 1
    assert power == pytest.approx(share * 0.2927, rel=0.1)


def test_materials_behind_instances_and_without_ids_are_told_apart():
    box = {"type": "cube", "bsdf": {"type": "conductor", "id": "metal"}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "group": {"type": "shapegroup", "box": box},
            "copy": {"type": "instance", "group": {"type": "ref", "id": "group"}},
            "ball": {"type": "sphere", "bsdf": {"type": "twosided", "a": {"type": "diffuse"}}},
            "disc": {"type": "disk", "bsdf": {"type": "twosided", "a": {"type": "conductor"}}},
        },
        optimize=False,
    )
    found = sorted((m.kind, m.use) for m in list_materials(scene))
    assert found == [
        ("conductor", "traced through"),
        ("twosided conductor", "traced through"),
        ("twosided diffuse", "queried"),
    ]


def test_share_of_paths_that_land():
    down = mi.ScalarTransform4f().translate([0, 0, 1]).rotate([1, 0, 0], 180).scale(0.01)
    light = {"emitter": {"type": "area"}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "lamp": {"type": "rectangle", "to_world": down, "bsdf": {"type": "null"}, **light},
            "disc": {"type": "disk"},
        },
        optimize=False,
    )
    # A Lambertian lamp above the centre of a disc of radius 1: sin² of 45°.
    landed = trace_pilot(scene, None, seed=0, paths=20_000).photons > 0
    assert landed.mean() == pytest.approx(0.5, abs=0.015)


# --- the originals that lie beside the repository -----------------------------------------------


@pytest.mark.skipif(not ORIGINALS.is_dir(), reason="the originals are not there")
@pytest.mark.parametrize(("folder", "diagonal"), [("veach-ajar", 19.32), ("veach-bidir", 13.91)])
def test_originals_are_imported_without_a_hand_edit(root, folder, diagonal):
    report = bring(ORIGINALS / folder, root)
    assert report.scene.diagonal == pytest.approx(diagonal, abs=0.01)
    assert report.scene.landing > 0.9
    assert report.scene.emitters == {"area": 1 if folder == "veach-ajar" else 2}
    assert report.warnings == report.scene.warnings == ()
    assert (root / "room/LICENSE.txt").exists()
    aspect = 1280 / 720 if folder == "veach-ajar" else 1
    assert load_views("room", root).aspect == pytest.approx(aspect)
