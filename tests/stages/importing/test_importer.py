"""Somebody else's scene becomes one of the project's, and the report says what was found in it."""

from __future__ import annotations

import re
import zipfile
from io import StringIO
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from rich.console import Console

from gpf.guiding.pilot import trace_pilot
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.folders import list_scenes, load_views
from gpf.scene.load import load_scene
from gpf.scene.snapshot import snapshot_scene
from gpf.scene.views import View
from stages.importing.description import print_report
from stages.importing.materials import Material, list_materials
from stages.importing.report import examine_scene
from tests.stages.importing.foreign_scene import LIGHT, SCENE, bring, files_of, pack

ORIGINALS = Path(__file__).parents[4] / "shared/scenes"

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
    snapshot_scene("room", tmp_path / "frozen", root)
    assert files_of(tmp_path / "frozen") == sorted(set(IMPORTED) - {"LICENSE.txt", "README.md"})


@pytest.mark.parametrize("version", ["0.5.0", "0.6.0", "2.2.1"])
def test_scenes_of_old_versions_are_imported_as_they_are(original, root, version):
    wanted = bring(original, root, "new")
    old = SCENE.replace('"3.0.0"', f'"{version}"')
    if version < "2":
        old = old.replace(
            '<float name="fov"', '<float name="nearClip" value="0.1"/><float name="fov"'
        )
        old = old.replace("to_world", "toWorld")
    assert "3.0.0" not in old
    (original / "scene.xml").write_text(old)
    (original / "parts/light.xml").write_text(LIGHT.replace("3.0.0", version))
    report = bring(original, root)
    assert (report.scene, report.views, report.warnings) == (wanted.scene, wanted.views, ())
    assert (root / "room/scene.xml").read_text() == old
    assert len(load_scene("room", root=root).shapes()) == 3


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
    assert re.search(r"views +1 for training, 1 novel, no path\n", text.getvalue())
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
    assert "not imported: old.xml (not referenced)" in said
    assert f"the orthographic sensor in line {line} is not a camera: not imported" in said
    assert "it has 2 cameras" in said
    assert "not imported: views.yaml" in said
    assert "sensor camera has an aperture: views are in focus everywhere" in said
    assert "sensor b shows a mirror image: views are not mirrored" in said
    near = re.search(r"sensor camera clips everything nearer than 4 units.* (\d+)%", said)
    assert near and 5 < int(near[1]) < 60
    assert [view.name for view in report.views.train] == ["camera", "b"]
    for warning in report.warnings:
        assert warning in (root / "room/README.md").read_text()


def test_scene_xml_is_preferred_and_rubbish_of_other_systems_ignored(original, root, tmp_path):
    (original / "a.xml").write_text(SCENE)
    archive = pack(original, tmp_path / "room.zip")
    with zipfile.ZipFile(archive, "a") as opened:
        opened.writestr("__MACOSX/Their Room/scene.xml", b"\0")
        opened.writestr("Their Room/._scene.xml", b"\0")
    report = bring(archive, root)
    assert report.warnings == ("not imported: a.xml (not referenced)",)


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
    assert said.startswith("participating medium: 1 homogeneous")
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
    power = np.array(record_photons(scene, PathSettings(1000), seed=1).power)[0].sum()
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
    landed = trace_pilot(scene, None, PathSettings(20_000), seed=0).photons > 0
    assert landed.mean() == pytest.approx(0.5, abs=0.015)


# --- the originals that lie beside the repository -----------------------------------------------


@pytest.mark.skipif(
    not ORIGINALS.is_dir(),
    reason="needs the original scenes, no part of this repository",
)
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
