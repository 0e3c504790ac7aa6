"""The benchmark scenes themselves, and the words for scenes that are not in order."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf import scenes
from gpf.errors import UserError

PROJECT = Path(__file__).parent.parent
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
        scenes.build_scene(name, root)
    return root


@pytest.fixture(scope="session", params=NAMES)
def loaded(request, root):
    return request.param, scenes.load_scene(request.param, 8, 6, root), root


def make_scene(root: Path, text: str = GOOD_SCENE, name: str = "ball") -> Path:
    (root / name).mkdir()
    (root / name / "scene.xml").write_text(text)
    return root


def first_hits(scene, view, width=24, height=18, seed=0):
    """Rays of a view, one per pixel, and their first intersections."""
    sensor = scenes.make_sensor(view, width, height)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, width * height)
    index = dr.arange(mi.UInt32, width * height)
    pixel = mi.Point2f(index % width, index // width) + sampler.next_2d()
    ray, _ = sensor.sample_ray(0.0, 0.0, pixel / mi.Point2f(width, height), mi.Point2f(0.5))
    return mi.Ray3f(ray), sampler


def share_on_diffuse(scene, view) -> float:
    """The share of pixels whose path, through specular bounces, ends on the front of a diffuse
    surface."""
    ray, sampler = first_hits(scene, view)
    active = mi.Bool(True)
    ended = dr.zeros(mi.Bool, dr.width(ray.o))
    for _ in range(16):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        bsdf = si.bsdf(ray)
        diffuse = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
        ended |= diffuse & (si.wi.z > 0)
        active &= ~diffuse
        sample, weight = bsdf.sample(
            mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), active
        )
        active &= dr.max(weight) > 0
        ray = si.spawn_ray(si.to_world(sample.wo))
        dr.eval(ray, active, ended, sampler)
    return float(np.mean(np.array(ended)))


def test_scenes_render_finite_radiance(loaded):
    name, scene, root = loaded
    view = scenes.load_views(name, root).train[0]
    image = np.array(mi.render(scene, sensor=scenes.make_sensor(view, 8, 6), spp=16))
    assert image.shape == (6, 8, 3)
    assert np.isfinite(image).all()
    # Above the water even a path tracer sees the lamp's light, if seldom.
    assert image.mean() > (0.05 if name == "cornell_box" else 0)


def test_scenes_render_in_the_scalar_variant(root):
    program = (
        "import sys, numpy as np, mitsuba as mi\n"
        "mi.set_variant('scalar_rgb')\n"
        "from pathlib import Path\n"
        "from gpf import scenes\n"
        "for name in ('cornell_box', 'water_caustic'):\n"
        "    scene = scenes.load_scene(name, 8, 6, Path(sys.argv[1]))\n"
        "    image = np.array(mi.render(scene, spp=2))\n"
        "    assert image.shape == (6, 8, 3) and np.isfinite(image).all()\n"
        "    print(name, scenes.scene_info(scene)['emitters']['count'])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(root)], capture_output=True, text=True, cwd=PROJECT
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["cornell_box 1", "water_caustic 1"]


def test_cornell_box_is_mitsubas(root):
    original = mi.load_dict(mi.cornell_box(), optimize=False)
    ours = scenes.load_scene("cornell_box", root=root)
    assert {s.id() for s in ours.shapes()} == {s.id() for s in original.shapes()}
    theirs, here = mi.traverse(original), mi.traverse(ours)
    compared = [key for key in here.keys() if key in theirs.keys()]  # noqa: SIM118
    assert {"floor.to_world", "light.emitter.radiance.value", "sensor.to_world"} <= set(compared)
    for key in compared:
        value = here[key]
        if hasattr(value, "matrix"):
            np.testing.assert_allclose(
                np.array(value.matrix), np.array(theirs[key].matrix), atol=1e-6, err_msg=key
            )
        elif not isinstance(value, mi.ScalarPoint2u | mi.ScalarVector2u):
            np.testing.assert_allclose(np.array(value), np.array(theirs[key]), atol=1e-6)


def test_first_training_view_is_the_scenes_own_sensor(loaded):
    name, scene, root = loaded
    own = scene.sensors()[0]
    made = scenes.make_sensor(scenes.load_views(name, root).train[0], 8, 6)
    corner = mi.Point2f(0.1, 0.8)
    rays = [sensor.sample_ray(0.0, 0.0, corner, mi.Point2f(0.5))[0] for sensor in (own, made)]
    np.testing.assert_allclose(np.array(rays[0].d), np.array(rays[1].d), atol=1e-5)
    np.testing.assert_allclose(np.array(rays[0].o), np.array(rays[1].o), atol=2e-2)


def test_views_are_many_and_apart(loaded):
    name, _, root = loaded
    views = scenes.load_views(name, root)
    assert len(views.train) == 3
    assert len(views.novel) >= 4
    assert len(views.frames()) == 24
    for novel in views.novel:
        for train in views.train:
            assert np.linalg.norm(np.subtract(novel.origin, train.origin)) > 0.3


def test_cameras_stand_in_the_air_and_see_diffuse_surfaces(loaded):
    name, scene, root = loaded
    views = scenes.load_views(name, root)
    for view in (*views.train, *views.novel, *views.frames()[::5]):
        ray, _ = first_hits(scene, view)
        si = scene.ray_intersect(ray)
        # A camera inside a box, under water or behind a wall would meet surfaces from behind.
        behind = si.is_valid() & (dr.dot(si.n, ray.d) > 0)
        assert np.mean(np.array(behind)) < 0.01, view.name
        assert share_on_diffuse(scene, view) > 0.5, view.name


def test_water_is_rebuilt_bit_for_bit(root, tmp_path):
    shutil.copytree(root / "water_caustic", tmp_path / "water_caustic")
    built = sorted((tmp_path / "water_caustic" / "meshes").iterdir())
    before = [file.read_bytes() for file in built]
    for file in built:
        file.unlink()
    again = scenes.build_scene("water_caustic", tmp_path)
    assert sorted(again) == built
    assert [file.read_bytes() for file in built] == before
    assert sum(map(len, before)) < 10e6
    assert not list((tmp_path / "water_caustic").glob(".build-*"))


def test_water_has_the_dimensions_of_the_original(root):
    meshes = {s.id(): s for s in scenes.load_scene("water_caustic", root=root).shapes()}
    surface, sheet = meshes["water-surface"], meshes["water-sheet"]
    assert surface.face_count() == pytest.approx(100_000, rel=0.01)
    box = surface.bbox()
    assert (float(box.min.y), float(box.max.y)) == pytest.approx((1.326, 1.667), abs=1e-5)
    points = [
        np.array(mi.traverse(mesh)["vertex_positions"]).reshape(-1, 3) for mesh in (surface, sheet)
    ]
    edge = points[0][points[0][:, 2] == 1]
    # the sheet takes the surface's edge over: the same numbers, not close ones
    assert set(map(tuple, edge)) <= set(map(tuple, points[1]))
    assert len(edge) * 2 == len(points[1])
    assert (points[1][:, 2] == 1).all()


def under_water(sampler) -> mi.Point3f:
    return mi.Point3f(
        2 * sampler.next_1d() - 1, 1.32 * sampler.next_1d(), 2 * sampler.next_1d() - 1
    )


def shares_of(si, scene) -> dict[str, float]:
    hit = {s.id(): np.array(si.shape == mi.ShapePtr(s)) for s in scene.shapes()}
    return {name: float(mask.mean()) for name, mask in hit.items() if mask.any()}


def test_light_reaches_the_water_through_its_surface_alone(root):
    scene = scenes.load_scene("water_caustic", root=root)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, 400_000)
    lamp = mi.Point3f(
        -0.005 + 0.005 * (sampler.next_1d() - 0.5),
        1.9799,
        -0.03 + 0.004 * (sampler.next_1d() - 0.5),
    )
    si = scene.ray_intersect(mi.Ray3f(lamp, dr.normalize(under_water(sampler) - lamp)))
    assert shares_of(si, scene) == {"water-surface": 1.0}
    assert np.array(si.n.y > 0).all()  # outwards: int_ior holds below


def test_water_has_no_holes(root):
    scene = scenes.load_scene("water_caustic", root=root)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(4, 400_000)
    direction = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    si = scene.ray_intersect(mi.Ray3f(under_water(sampler), direction))
    shares = shares_of(si, scene)
    assert np.array(si.is_valid()).all()
    assert "light" not in shares
    assert "ceiling" not in shares
    water = np.array(si.shape == mi.ShapePtr(next(s for s in scene.shapes() if "sheet" in s.id())))
    leaves = np.array(dr.dot(si.n, direction) > 0)
    assert water.any()
    assert leaves[water].all()


def test_scene_info_counts_and_classifies(tmp_path):
    info = scenes.scene_info(scenes.load_scene("ball", root=make_scene(tmp_path)))
    assert info["emitters"] == {"count": 1, "types": {"AreaLight": 1}}
    assert info["bbox"] == {"min": [-1, -1, -1], "max": [4, 1, 1]}
    assert [shape["id"] for shape in info["shapes"]] == ["ball", "pane"]
    assert info["shapes"][1]["bsdf"] == "gloss"
    assert (info["bsdfs"]["grey"]["queried"], info["bsdfs"]["grey"]["traced"]) == (True, False)
    assert (info["bsdfs"]["gloss"]["queried"], info["bsdfs"]["gloss"]["traced"]) == (True, True)


def test_water_is_traced_through(root):
    bsdfs = scenes.scene_info(scenes.load_scene("water_caustic", root=root))["bsdfs"]
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
    ],
)
def test_bad_scene_files_are_told_in_words(tmp_path, old, new, words):
    with pytest.raises(UserError, match=words):
        scenes.load_scene("ball", root=make_scene(tmp_path, re.sub(old, new, GOOD_SCENE)))


def test_a_lone_shape_is_no_scene(tmp_path):
    make_scene(tmp_path, '<shape version="3.9.0" type="sphere"/>')
    with pytest.raises(UserError, match=r"describes a .*Its outermost tag has to be <scene>"):
        scenes.load_scene("ball", root=tmp_path)


def test_unbuilt_meshes_name_the_stage_that_builds_them(tmp_path):
    shutil.copytree(
        PROJECT / "scenes/water_caustic",
        tmp_path / "water_caustic",
        ignore=shutil.ignore_patterns("meshes"),
    )
    with pytest.raises(
        UserError, match=r"surface\.ply \(and 1 more\).*gpf stage scene --scene water_caustic"
    ):
        scenes.load_scene("water_caustic", root=tmp_path)


def test_unknown_scenes_get_a_suggestion(root):
    with pytest.raises(
        UserError,
        match=r"'cornel_box': does not exist\. Did you mean 'cornell_box'\? "
        r"The scenes are cornell_box, water_caustic",
    ):
        scenes.load_views("cornel_box", root)


def test_scene_files_name_everything_a_scene_needs(root):
    names = [str(file.relative_to(root)) for file in scenes.scene_files("water_caustic", root)]
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
    files = [file.name for file in scenes.scene_files("ball", tmp_path)]
    assert sorted(files) == ["b.xml", "c.ply", "scene.xml"]


def test_scenes_are_found_from_below_and_by_variable(tmp_path, monkeypatch):
    monkeypatch.delenv("GPF_SCENES", raising=False)
    project = tmp_path / "project"
    (project / "deep/down").mkdir(parents=True)
    (project / "scenes").mkdir()
    monkeypatch.chdir(project / "deep/down")
    with pytest.raises(UserError, match="neither this folder nor one above it has scenes"):
        scenes.scenes_root()
    make_scene(project / "scenes")
    assert scenes.scenes_root() == project / "scenes"
    assert scenes.list_scenes() == ["ball"]
    (tmp_path / "other").mkdir()
    monkeypatch.setenv("GPF_SCENES", str(tmp_path / "other"))
    assert scenes.list_scenes() == []
    monkeypatch.setenv("GPF_SCENES", str(tmp_path / "nowhere"))
    with pytest.raises(UserError, match=r"GPF_SCENES: .*nowhere is not a folder"):
        scenes.scenes_root()


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
        scenes.build_scene("ball", tmp_path)
    assert built.read_text() == "old"
    (tmp_path / "ball/build.py").write_text("x = 1\n")
    with pytest.raises(UserError, match="has no function build"):
        scenes.build_scene("ball", tmp_path)
    names = {file.name for file in (tmp_path / "ball").iterdir()}
    assert names - {"__pycache__"} == {"build.py", "mesh.bin", "scene.xml"}
