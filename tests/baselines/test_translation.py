"""Descriptions of scenes for other renderers: what is in them, without those renderers."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from baselines.protocol import CannotServe
from baselines.translation.description import describe
from baselines.translation.materials import mean_fresnel
from baselines.translation.nodes import read_dict, read_file
from gpf.core.structs import from_numpy
from gpf.scene.load import load_scene_file
from tests.baselines.peer_scenes import LAMPS, MATERIALS, at, board, glass, picture
from tests.furnace import Scene, bitmap, diffuse, rgb

CORNELL = Path(__file__).parents[2] / "scenes" / "cornell_box" / "scene.xml"


def described(folder: Path, **objects: Any) -> Any:
    scene = {"type": "scene"} | objects
    loaded = mi.load_dict(scene, optimize=False)
    describe(read_dict(scene), loaded, folder, "scene.xml")
    return json.loads((folder / "scene.json").read_text())


def material(folder: Path, bsdf: Scene) -> Any:
    found = described(folder, shape={"type": "rectangle", "bsdf": bsdf})
    return found["materials"][0]


def lamp(folder: Path, name: str) -> Any:
    return described(folder, lamp=LAMPS[name]())["lamps"][0]


def test_a_scene_file(tmp_path: Path) -> None:
    scene = load_scene_file(CORNELL)
    found = describe(read_file(CORNELL), scene, tmp_path, "cornell")
    assert [shape["name"] for shape in found["shapes"]] == [s.id() for s in scene.shapes()]
    light = found["shapes"][0]
    np.testing.assert_allclose(light["radiance"], (18.387, 13.9873, 6.75357), rtol=1e-5)
    assert light["outline"] == "rectangle" and "radiance" not in found["shapes"][1]
    assert len(found["materials"]) == 3  # shapes share them
    with np.load(tmp_path / light["mesh"]) as mesh:
        corners = np.stack([mesh["points"].min(axis=0), mesh["points"].max(axis=0)])
    bounds = scene.shapes()[0].bbox()
    np.testing.assert_allclose(corners, np.stack([bounds.min, bounds.max]), atol=1e-6)


@pytest.mark.parametrize("kind", ["rectangle", "disk", "sphere", "cylinder", "cube"])
def test_meshes_are_in_the_world_with_mitsubas_texture_coordinates(tmp_path, kind) -> None:
    sizes = (2, 1, 1.5) if kind in ("rectangle", "cube") else 2
    turn = ("rotate", ((0.6, 0.8, 0), 50))
    to_world = at(("scale", sizes), turn, ("translate", (1, 2, 3)))
    shape = {"type": kind, "to_world": to_world, "bsdf": diffuse(0.5)}
    described(tmp_path, shape=shape)
    scene = mi.load_dict({"type": "scene", "shape": shape})
    with np.load(tmp_path / "mesh_0.npz") as mesh:
        points, faces, uv = mesh["points"], mesh["faces"], mesh["uv"]
        normals = mesh.get("normals")
    corners = points[faces]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    some = np.random.default_rng(1).choice(len(faces), min(len(faces), 50), replace=False)
    middle = corners[some].mean(axis=1)
    origin = from_numpy(mi.Point3f, middle + 0.1 * facing[some])
    ray = mi.Ray3f(origin, from_numpy(mi.Vector3f, -facing[some]))
    si = scene.ray_intersect(ray)
    np.testing.assert_allclose(np.array(si.p).T, middle, atol=6e-3)
    assert ((np.array(si.n).T * facing[some]).sum(axis=1) > 0.99).all()
    away = uv[faces[some]].mean(axis=1) - np.array(si.uv).T
    assert np.abs(away - np.round(away)).max() < 0.02
    if normals is not None:
        across = normals[faces[some]].mean(axis=1)
        assert ((np.array(si.sh_frame.n).T * across).sum(axis=1) > 0.99).all()


def test_instances_share_a_mesh(tmp_path: Path) -> None:
    group = {
        "type": "shapegroup",
        "id": "group",
        "ball": {"type": "sphere", "radius": 0.3, "bsdf": diffuse(0.2)},
        "box": {"type": "cube", "bsdf": glass()},
    }
    moved = {"type": "instance", "g": {"type": "ref", "id": "group"}}
    copies = {f"copy_{k}": moved | {"to_world": at(("translate", (k, 2, 3)))} for k in range(2)}
    found = described(tmp_path, floor={"type": "rectangle"}, group=group, **copies)
    shapes = found["shapes"]
    assert [s["mesh"] for s in shapes] == [f"mesh_{k}.npz" for k in (0, 1, 2, 1, 2)]
    assert [s["matrix"] and s["matrix"][0][3] for s in shapes] == [None, 0, 0, 1, 1]
    kinds = [found["materials"][s["material"]]["kind"] for s in shapes]
    assert kinds == ["sides", "sides", "dielectric", "sides", "dielectric"]


def test_one_sided_surfaces_are_black_behind(tmp_path: Path) -> None:
    black = {"kind": "diffuse", "color": 0.0}
    found = material(tmp_path, diffuse(0.25, 0.5, 0.75))
    assert found == {
        "kind": "sides",
        "front": {"kind": "diffuse", "color": [0.25, 0.5, 0.75]},
        "back": black,
    }
    both = material(tmp_path, {"type": "twosided", "bsdf": diffuse(0.25, 0.5, 0.75)})
    assert both == found["front"]
    bent = material(tmp_path, {"type": "bumpmap", "map": picture(), "bsdf": diffuse(0.5)})
    assert bent["back"] == black and bent["front"]["inside"]["kind"] == "diffuse"


@pytest.mark.parametrize("name", MATERIALS)
def test_every_material_has_a_description(tmp_path: Path, name: str) -> None:
    found = material(tmp_path, MATERIALS[name]())
    assert found["kind"] in json.dumps(found) and "NaN" not in json.dumps(found)


def test_metals_have_their_optical_constants(tmp_path: Path) -> None:
    found = material(tmp_path, MATERIALS["ggx"]())["front"]
    bsdf = mi.traverse(mi.load_dict({"type": "conductor", "material": "Cu"}))
    np.testing.assert_allclose(found["eta"], np.ravel(bsdf["eta.value"]))
    np.testing.assert_allclose(found["k"], np.ravel(bsdf["k.value"]))
    assert found["alpha"] == pytest.approx([0.3, 0.3]) and found["distribution"] == "ggx"
    assert material(tmp_path, MATERIALS["mirror"]())["front"]["eta"] is None


def test_glass(tmp_path: Path) -> None:
    found = material(tmp_path, glass(int_ior="water", ext_ior=1.5, specular_reflectance=rgb(0.5)))
    assert found["ior"] == pytest.approx(1.3330 / 1.5, rel=1e-3) and found["alpha"] == [0, 0]
    assert found["reflectance"] == pytest.approx([0.5] * 3) and found["transmittance"] == 1


@pytest.mark.parametrize("nonlinear", [False, True])
def test_plastic_keeps_what_bounces_between_base_and_coat(tmp_path, nonlinear) -> None:
    """ρ, or ρ (1 - F) / (1 - ρ F) with F for light from within."""
    plastic = {"type": "plastic", "int_ior": 1.5, "ext_ior": 1.0, "nonlinear": nonlinear}
    found = material(tmp_path, plastic | {"diffuse_reflectance": rgb(0.2, 0.5, 0.9)})
    rho, inside = np.array([0.2, 0.5, 0.9]), 1 - (1 - mean_fresnel(1.5)) / 1.5**2
    expected = rho * (1 - inside) / (1 - rho * inside) if nonlinear else rho
    np.testing.assert_allclose(found["front"]["color"], expected, rtol=0.005)


def test_images_are_linear_and_know_their_place(tmp_path: Path) -> None:
    pixels = np.linspace(0.1, 0.9, 2 * 3 * 3).reshape(2, 3, 3)
    to_uv = at(("scale", (2, 3, 1)), ("translate", (0.1, 0.2, 0)))
    texture = bitmap(pixels, to_uv=to_uv, wrap_mode="mirror", filter_type="nearest")
    found = material(tmp_path, {"type": "diffuse", "reflectance": texture})["front"]["color"]
    np.testing.assert_allclose(np.load(tmp_path / found["image"]), pixels, rtol=1e-5)
    np.testing.assert_allclose(found["to_uv"], [[2, 0, 0.1], [0, 3, 0.2]], atol=1e-6)
    assert found["wrap"] == "mirror" and found["nearest"]


def test_a_checkerboard_is_four_texels(tmp_path: Path) -> None:
    """As a colour and as a number, each as Mitsuba has it."""
    two = {"type": "checkerboard", "color0": rgb(0.1), "color1": rgb(0.7)}
    masked = {"type": "mask", "opacity": two, "bsdf": {"type": "diffuse", "reflectance": two}}
    found = material(tmp_path, masked)
    coloured = np.load(tmp_path / found["second"]["front"]["color"]["image"])[..., 0]
    numbers = np.load(tmp_path / found["weight"]["image"])[..., 0]
    texture = mi.load_dict(two)
    si = mi.SurfaceInteraction3f()
    si.uv = mi.Point2f([0.2, 0.7, 0.2, 0.7], [0.2, 0.2, 0.7, 0.7])
    np.testing.assert_allclose(coloured.ravel(), np.array(texture.eval(si))[0], rtol=1e-5)
    np.testing.assert_allclose(numbers.ravel(), np.array(texture.eval_1(si)), rtol=1e-5)


def test_lamps(tmp_path: Path) -> None:
    point = lamp(tmp_path, "point")
    assert point == {"kind": "point", "position": [-1, -2, 3], "intensity": [20, 30, 10]}
    spot = lamp(tmp_path, "spot")
    assert math.degrees(spot["cutoff"]) == pytest.approx(24)
    assert math.degrees(spot["beam"]) == pytest.approx(8)
    np.testing.assert_allclose(np.array(spot["matrix"])[:3, 3], (2, -3, 4))
    sun = lamp(tmp_path, "directional")
    np.testing.assert_allclose(np.linalg.norm(sun["direction"]), 1)
    assert sun["irradiance"] == [3, 2, 1]
    assert lamp(tmp_path, "constant")["radiance"] == pytest.approx([0.5, 0.7, 0.9])
    projector = lamp(tmp_path, "projector")
    half = math.tan(math.radians(20))
    np.testing.assert_allclose(projector["size"], (2 * half, 2 * half * 5 / 8), rtol=1e-6)


def test_a_sky_keeps_its_light_where_it_is(tmp_path: Path) -> None:
    found = lamp(tmp_path, "envmap")
    pixels = np.load(tmp_path / found["image"])
    rows, columns = pixels.shape[:2]
    ray = mi.Ray3f(mi.Point3f(0), mi.Vector3f(0, 0, 0))
    scene = mi.load_dict({"type": "scene", "sky": LAMPS["envmap"]()})
    for row, column in ((2, 3), (5, 9), (9, 30), (14, 17)):
        theta, phi = math.pi * (row + 0.5) / rows, 2 * math.pi * (column + 0.5) / columns
        local = (math.sin(theta) * math.sin(phi), math.cos(theta), -math.sin(theta) * math.cos(phi))
        x, y, z = np.array(found["matrix"])[:3, :3] @ local
        ray.d = mi.Vector3f(float(x), float(y), float(z))
        si = scene.ray_intersect(ray)
        expected = np.array(scene.environment().eval(si)).ravel()
        np.testing.assert_allclose(pixels[row, column], expected, rtol=1e-3)


FACES = {"type": "mesh_attribute", "name": "face_paint"}


@pytest.mark.parametrize(
    ("objects", "reason"),
    [
        ({"shape": {"type": "rectangle", "bsdf": {"type": "hair"}}}, "materials of type hair"),
        (
            {
                "shape": {
                    "type": "cube",
                    "inside": {"type": "homogeneous"},
                    "bsdf": {"type": "null"},
                }
            },
            "participating media",
        ),
        (
            {"shape": {"type": "rectangle", "emitter": {"type": "directionalarea"}}},
            "lamps of type directionalarea",
        ),
        (
            {"shape": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": FACES}}},
            "textures of type mesh_attribute",
        ),
        ({"lamp": {"type": "spot", "texture": board()}}, "spots with a texture"),
    ],
)
def test_what_is_not_translated_is_named(tmp_path, objects, reason) -> None:
    with pytest.raises(CannotServe, match=reason):
        described(tmp_path, **objects)
