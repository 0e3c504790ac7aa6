"""The benchmark scenes themselves, and the words for scenes that are not in order."""

import re
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import drjit as dr
import mitsuba as mi
import pytest

from gpf.core.errors import UserError
from gpf.scene.fingerprint import fingerprint
from gpf.scene.folders import list_scenes, load_views, scene_files, scenes_root
from gpf.scene.inventory import check_scene, scene_materials
from gpf.scene.load import load_scene, load_scene_file
from gpf.scene.snapshot import build_scene
from stages.common.inventory import scene_info

PROJECT = Path(__file__).parents[2]
NAMES = ("cornell_box", "water_caustic")

GOOD_SCENE = """\
<scene version="3.9.0">
    <default name="resx" value="4"/>
    <shape type="sphere" id="ball">
        <bsdf type="diffuse" id="grey"/>
        <emitter type="area"/>
    </shape>
    <shape type="sphere" id="pane">
        <point name="center" x="3" y="0" z="0"/>
        <bsdf type="plastic" id="gloss"/>
    </shape>
</scene>
"""


@pytest.fixture(scope="session")
def root(tmp_path_factory) -> Path:
    """A copy of the project's scenes, built."""
    root = tmp_path_factory.mktemp("scenes")
    for name in NAMES:
        source = PROJECT / "scenes" / name
        shutil.copytree(source, root / name, ignore=shutil.ignore_patterns("meshes", "__pycache__"))
        build_scene(name, root)
    return root


def make_scene(root: Path, text: str = GOOD_SCENE, name: str = "ball") -> Path:
    (root / name).mkdir()
    (root / name / "scene.xml").write_text(text)
    return root


@pytest.mark.parametrize(
    ("kind", "place", "tags", "what"),
    [
        ("foreign", "plugins/foreign.so", "", "would be run by Mitsuba"),
        ("foreign.x", "plugins/foreign.so", "", "would be run by Mitsuba"),
        # Instead of Mitsuba's own, also where the scene file does not name it.
        ("diffuse", "plugins/diffuse.so", "", "would be run by Mitsuba"),
        ("diffuse", "plugins/independent.so", "", "would be run by Mitsuba"),
        ("foreign", "inner/plugins/foreign.so", '<path value="inner"/>', "would be run by Mitsuba"),
        ("../foreign", "foreign.so", "", "has a type that is a path"),
    ],
)
def test_a_library_beside_the_scene_is_not_run(tmp_path, kind, place, tags, what):
    folder = make_scene(tmp_path, GOOD_SCENE.replace("diffuse", kind)) / "ball"
    file, library = folder / "scene.xml", folder / place
    file.write_text(file.read_text().replace("    <shape", f"    {tags}<shape", 1))
    library.parent.mkdir(parents=True, exist_ok=True)
    library.write_bytes(b"no library")
    with pytest.raises(UserError, match=what):
        load_scene_file(file)


def test_a_library_in_the_current_folder_is_not_run(tmp_path):
    file = make_scene(tmp_path) / "ball" / "scene.xml"
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "independent.so").write_bytes(b"no library")
    program = "import gpf, sys; gpf.choose_variant('auto'); from pathlib import Path; "
    program += "gpf.load_scene_file(Path(sys.argv[1]))"
    command = [sys.executable, "-c", program, str(file)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert "would be run by Mitsuba" in done.stderr


def test_scene_info_counts_and_classifies(tmp_path):
    info = scene_info(load_scene("ball", root=make_scene(tmp_path)))
    assert info["emitters"] == {"count": 1, "types": {"AreaLight": 1}}
    assert info["bbox"] == {"min": [-1, -1, -1], "max": [4, 1, 1]}
    assert [shape["id"] for shape in info["shapes"]] == ["ball", "pane"]
    assert info["shapes"][1]["bsdf"] == "gloss"
    assert (info["bsdfs"]["grey"]["queried"], info["bsdfs"]["grey"]["traced"]) == (True, False)
    assert (info["bsdfs"]["gloss"]["queried"], info["bsdfs"]["gloss"]["traced"]) == (True, True)


def test_materials_of_the_same_name_get_numbers():
    one, two = mi.load_dict({"type": "diffuse"}), mi.load_dict({"type": "diffuse"})
    shapes = [mi.load_dict({"type": "cube", "bsdf": bsdf}) for bsdf in (one, two, one)]
    scene = mi.load_dict({"type": "scene", **{f"{k}": shape for k, shape in enumerate(shapes)}})
    assert list(scene_materials(scene)) == ["bsdf", "bsdf (2)"]


def test_naming_twice_as_many_materials_takes_twice_as_many_steps():
    def steps(count: int) -> int:
        shapes = '<shape type="sphere"/>' * count
        scene, lines = mi.load_string(f'<scene version="3.9.0">{shapes}</scene>'), []

        def trace(frame, event, argument):
            if frame.f_code is scene_materials.__code__:
                lines.append(event)
                return trace
            return None

        before = sys.gettrace()
        sys.settrace(trace)
        try:
            assert len(scene_materials(scene)) == count
        finally:
            sys.settrace(before)
        return len(lines)

    assert steps(80) < 2.2 * steps(40)


def test_water_is_traced_through(root):
    bsdfs = scene_info(load_scene("water_caustic", root=root))["bsdfs"]
    assert {name for name, bsdf in bsdfs.items() if bsdf["queried"]} == {"white", "red", "green"}
    assert {name for name, bsdf in bsdfs.items() if bsdf["traced"]} == {"water"}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("</scene>", "</scen>", r"scene\.xml: does not parse: .*line 11.*Correct the XML"),
        ('type="plastic"', 'type="plastique"', r"does not load: .*line.*plastique"),
        ('<emitter type="area"/>', "", r"has no emitters, so there are no photons\. Add a light"),
        ("diffuse|plastic", "conductor", r"has no diffuse surface.*Give at least one shape"),
        (
            "</scene>",
            '<shape type="ply"><string name="filename" value="lost.ply"/></shape></scene>',
            r"refers to .*lost\.ply, which does not exist\. Put it there",
        ),
        ("(?s)^.+$", '<shape version="3.9.0" type="sphere"/>', "describes a .* must be <scene>"),
        # The next two would end the process in Mitsuba.
        ('0">', '0">\n<bsdf type="blendbsdf"/>', r"\(line 2, col 2\): is a blendbsdf without mat"),
        ('0">', '0">\n<texture type="bitmap"/>', r"\(line 2, col 2\): is a bitmap without filen"),
        # A plugin in Python, whose errors come with their traceback.
        (
            '<bsdf type="plastic" id="gloss"/>',
            '<bsdf type="principled"><vector name="roughness" value="1, 2, 3"/></bsdf>',
            r'"roughness" has the wrong type',
        ),
    ],
)
def test_bad_scene_files_are_told_in_words(tmp_path, old, new, words):
    text = re.sub(old, new, GOOD_SCENE)
    assert text != GOOD_SCENE
    with pytest.raises(UserError, match=words) as caught:
        load_scene("ball", root=make_scene(tmp_path, text))
    assert "Traceback" not in str(caught.value) and "principled.py" not in str(caught.value)


def test_a_scene_that_does_not_load_leaves_no_emitters(tmp_path):
    """Their shapes are gone: the next kernel that calls emitters would end the process."""
    broken = GOOD_SCENE.replace("</scene>", '<shape type="cone"/></scene>')
    assert "<emitter" in broken
    before = living_emitters()
    with pytest.raises(UserError, match="cone") as kept:
        load_scene("ball", root=make_scene(tmp_path, broken))
    assert living_emitters() <= before
    del kept


def living_emitters() -> int:
    """How many emitters Dr.Jit calls; 256 at most."""
    found = 0
    for number in range(1, 257):
        with suppress(RuntimeError):  # no such number
            emitter = dr.reinterpret_array(mi.EmitterPtr, mi.UInt32(number))[0]
            found += emitter is not None
    return found


def test_unbuilt_meshes_name_the_function_that_builds_them(tmp_path):
    without = shutil.ignore_patterns("meshes")
    shutil.copytree(PROJECT / "scenes/water_caustic", tmp_path / "water_caustic", ignore=without)
    words = r"surface\.ply \(and 1 more\).*build\.py.*snapshot\.build_scene\('water_caustic'\)"
    with pytest.raises(UserError, match=words):
        load_scene("water_caustic", root=tmp_path)


def test_unknown_scenes_get_a_suggestion(root):
    words = r"'cornel_box': does not exist\. Did you mean 'cornell_box'\? The scenes are "
    with pytest.raises(UserError, match=words + "cornell_box, water_caustic"):
        load_views("cornel_box", root)


def test_scene_files_name_everything_a_scene_needs(root):
    names = [str(file.relative_to(root)) for file in scene_files("water_caustic", root)]
    assert names == [
        "water_caustic/build.py",
        "water_caustic/meshes/sheet.ply",
        "water_caustic/meshes/surface.ply",
        "water_caustic/scene.xml",
        "water_caustic/views.yaml",
    ]


def test_included_files_and_parameters_are_followed(tmp_path):
    make_scene(
        tmp_path,
        '<scene version="3.9.0"><default name="kind" value="b"/><include filename="$kind.xml"/>'
        "</scene>",
    )
    (tmp_path / "ball/b.xml").write_text(
        '<scene version="3.9.0"><shape type="ply"><string name="filename" value="c.ply"/></shape>'
        "</scene>"
    )
    files = [file.name for file in scene_files("ball", tmp_path)]
    assert sorted(files) == ["b.xml", "c.ply", "scene.xml"]


def test_scenes_are_found_from_below_and_by_variable(tmp_path, monkeypatch):
    monkeypatch.delenv("GPF_SCENES", raising=False)
    project = tmp_path / "project"
    (project / "deep/down").mkdir(parents=True)
    (project / "scenes").mkdir()
    monkeypatch.chdir("/")  # nothing is above it
    with pytest.raises(UserError, match="nor any above it has scenes"):
        scenes_root()
    monkeypatch.chdir(project / "deep/down")
    with suppress(UserError):  # the folder of temporary files may be below somebody's scenes
        assert scenes_root() != project / "scenes"
    make_scene(project / "scenes")
    assert scenes_root() == project / "scenes"
    assert list_scenes() == ["ball"]
    (tmp_path / "other").mkdir()
    monkeypatch.setenv("GPF_SCENES", str(tmp_path / "other"))
    assert list_scenes() == []
    monkeypatch.setenv("GPF_SCENES", str(tmp_path / "nowhere"))
    with pytest.raises(UserError, match=r"GPF_SCENES: .*nowhere is not a folder"):
        scenes_root()


def test_a_failing_builder_leaves_the_old_files(tmp_path):
    make_scene(tmp_path)
    built = tmp_path / "ball/mesh.bin"
    built.write_text("old")
    (tmp_path / "ball/build.py").write_text(
        "def build(folder):\n"
        "    (folder / 'mesh.bin').write_text('half')\n"
        "    raise ValueError('out of clay')\n"
    )
    with pytest.raises(ValueError, match="out of clay"):
        build_scene("ball", tmp_path)
    assert built.read_text() == "old"
    (tmp_path / "ball/build.py").write_text("x = 1\n")
    with pytest.raises(UserError, match="has no function build"):
        build_scene("ball", tmp_path)
    (tmp_path / "ball/build.py").write_text("import no_such_module\n")
    with pytest.raises(UserError, match=r"build\.py: needs the module no_such_module\. Install it"):
        build_scene("ball", tmp_path)
    names = {file.name for file in (tmp_path / "ball").iterdir()}
    assert names - {"__pycache__"} == {"build.py", "mesh.bin", "scene.xml"}


def test_a_name_from_windows_gets_a_hint(tmp_path):
    text = '<scene version="3.0.0"><shape type="ply"><string name="filename" value="a\\b.ply"/>'
    (tmp_path / "scene.xml").write_text(f"{text}</shape></scene>")
    with pytest.raises(UserError, match=r"does not exist\. Separate folders with / instead of \\"):
        load_scene_file(tmp_path / "scene.xml")


def test_parameters_that_a_material_leaves_out_are_no_error():
    """As `hair` does: a scene with it can be checked, and has a fingerprint."""
    hair = {"type": "sphere", "bsdf": {"type": "hair"}}
    scene = mi.load_dict(
        {"type": "scene", "hair": hair, "floor": {"type": "rectangle"}, "light": {"type": "point"}}
    )
    check_scene(scene)
    assert fingerprint(scene)["materials"]
