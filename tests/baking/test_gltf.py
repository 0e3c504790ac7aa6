"""Binary glTF: what the files say is what the scene is."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.baking.albedo import read_albedo
from gpf.baking.gltf import Stage, write_glb
from gpf.baking.reflectance import bake_radiosity
from gpf.core.images import tone_map, undo_tone_map
from gpf.core.structs import from_numpy
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.baking.glb_file import Read
from tests.baking.known_light import look_up, on_triangles
from tests.baking.showroom import ASPECT, EXPOSURE, VIEWS, bake_showroom, grouped_field, showroom


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    scene = showroom(tmp_path_factory.mktemp("gltf"))
    baked, stage, members = bake_showroom(scene, grouped_field(scene), 256)
    radiosity = bake_radiosity(scene, baked, members)
    picture = np.round(255 * tone_map(radiosity[""] / np.pi, EXPOSURE)).astype(np.uint8)
    return scene, baked, radiosity, picture, Read(write_glb(stage, picture, EXPOSURE))


def test_all_shapes_are_there(made):
    scene, *_, file = made
    for shape in scene.shapes():
        attributes, faces, _ = file.part(shape.id())
        corners = attributes["POSITION"][faces].astype(float)
        box = shape.bbox()
        np.testing.assert_allclose(corners.min(axis=(0, 1)), np.array(box.min), atol=1e-3)
        np.testing.assert_allclose(corners.max(axis=(0, 1)), np.array(box.max), atol=1e-3)
        if "NORMAL" in attributes:
            length = np.linalg.norm(attributes["NORMAL"], axis=1)
            np.testing.assert_allclose(length, 1, atol=1e-5)
            a, b, c = corners.transpose(1, 0, 2)
            turned = np.cross(b - a, c - a) * attributes["NORMAL"][faces[:, 0]]
            assert (turned.sum(axis=1) > -1e-9).all()


def test_matte_surfaces_show_their_light(made):
    """Looked up on the floor: ρ E / π, tone mapped; the picture is as it was."""
    _, baked, _, picture, file = made
    attributes, faces, material = file.part("floor")
    assert material["emissiveFactor"] == [1, 1, 1]
    assert material["pbrMetallicRoughness"]["baseColorFactor"] == [0, 0, 0, 1]
    assert material["extensions"] == {"KHR_materials_specular": {"specularFactor": 0}}
    assert file.content["extensionsUsed"].count("KHR_materials_specular") == 1
    assert not material["doubleSided"] and file.part("stand")[2]["doubleSided"]
    shown = file.image(material["emissiveTexture"])
    assert shown.shape == picture.shape
    assert np.abs(shown.astype(int) - picture).mean() < 1.5  # a JPEG
    surface = next(c.surface for c in baked.atlas.charts if c.surface.name == "floor")
    albedo = read_albedo(surface)
    triangle, weights = on_triangles(surface, 500, np.random.default_rng(0))
    uv, own = attributes["TEXCOORD_0"][faces[triangle]], albedo.uv[surface.faces[triangle]]
    there, place = (np.einsum("pk,pki->pi", weights, part) for part in (uv, own))
    reflectance = undo_tone_map(look_up(np.tile(albedo.image, (5, 4, 1)) / 255, place / [4, 5]))
    expected = reflectance * look_up(baked.maps[""], there) / np.pi
    found = look_up(undo_tone_map(picture / 255), there)
    error = np.abs(found - np.clip(EXPOSURE * expected, 0, 1))
    assert np.median(error) < 0.01 and error.mean() < 0.02


def test_glossy_surfaces_emit_their_light(made):
    _, _, material = made[-1].part("toy")
    shiny = material["pbrMetallicRoughness"]
    assert shiny["baseColorFactor"] == [0, 0, 0, 1]
    assert shiny["roughnessFactor"] == pytest.approx(0.3)
    assert material["emissiveFactor"] == [1, 1, 1] and "extensions" not in material


def test_lamps_shine(made):
    _, baked, radiosity, _, file = made
    attributes, _, _ = file.part("lamp")
    middle = attributes["TEXCOORD_0"].mean(axis=0, keepdims=True)
    without = 0.7 * look_up(baked.maps["lamp"], middle)
    shines = look_up(radiosity["lamp"], middle) - without
    np.testing.assert_allclose(shines / np.pi, [[1.5, 1.2, 0.9]], rtol=1e-3)
    assert (
        np.abs(look_up(radiosity["sky"], middle) - 0.7 * look_up(baked.maps["sky"], middle)).max()
        < 1e-4
    )
    np.testing.assert_allclose(radiosity[""], radiosity["lamp"] + radiosity["sky"], atol=1e-4)


def test_gold_and_glass(made):
    file = made[-1]
    _, _, gold = file.part("ingot")
    metal = gold["pbrMetallicRoughness"]
    assert metal["metallicFactor"] == 1 and metal["roughnessFactor"] == pytest.approx(0.3)
    # ((η - 1)² + k²) / ((η + 1)² + k²) of gold.
    np.testing.assert_allclose(metal["baseColorFactor"][:3], [0.99, 0.80, 0.36], atol=0.06)
    _, _, glass = file.part("marble")
    assert glass["pbrMetallicRoughness"]["baseColorFactor"][:3] == pytest.approx(
        [1, 1, 1], abs=0.02
    )
    extensions = glass["extensions"]
    assert extensions["KHR_materials_transmission"] == {"transmissionFactor": 1}
    assert extensions["KHR_materials_ior"]["ior"] == pytest.approx(1.5, abs=1e-4)
    # From the surface straight through the middle.
    assert extensions["KHR_materials_volume"]["thicknessFactor"] == pytest.approx(0.6, abs=0.01)
    assert not glass["doubleSided"]


@pytest.mark.parametrize("axis", ["x", "y", "diagonal", "smaller", "larger"])
@pytest.mark.parametrize("aspect", [0.7, 1.6])
def test_cameras_see_what_sensors_see(made, axis, aspect):
    scene, baked = made[:2]
    view = VIEWS[1].model_copy(update={"fov_axis": axis})
    stage = Stage(scene, baked.atlas, [], [view], aspect)
    file = Read(write_glb(stage, np.zeros((4, 4, 3), np.uint8), 1))
    (node,) = (n for n in file.content["nodes"] if "camera" in n)
    camera = file.content["cameras"][node["camera"]]
    assert camera["name"] == node["name"] == "side"
    lens = camera["perspective"]
    place = np.array([[0.2, 0.7], [0.9, 0.3]])
    x, y = (2 * place - 1).T * [[1], [-1]]
    half = np.tan(lens["yfov"] / 2)
    own = np.stack([x * half * lens["aspectRatio"], y * half, -np.ones(2), np.zeros(2)], axis=1)
    ways = own @ np.array(node["matrix"]).reshape(4, 4)
    height = 200
    sensor = make_sensor(view, round(height * aspect), height)
    ray, _ = sensor.sample_ray(0.0, 0.5, from_numpy(mi.Point2f, place), mi.Point2f(0.5))
    expected = np.array(ray.d).T
    found = ways[:, :3] / np.linalg.norm(ways[:, :3], axis=1, keepdims=True)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    np.testing.assert_allclose(node["matrix"][12:15], view.origin)


def test_a_scene_whose_z_axis_points_upwards(made):
    scene, baked = made[:2]
    up = View(name="up", origin=(3, 0, 1), target=(0, 0, 0), up=(0, 0, 1), fov=50)
    for cameras, turned in (([up], True), (VIEWS, False), ([], False)):
        stage = Stage(scene, baked.atlas, [], cameras, ASPECT)
        content = Read(write_glb(stage, np.zeros((4, 4, 3), np.uint8), 1)).content
        root = content["nodes"][content["scenes"][content["scene"]]["nodes"][0]]
        assert len(root["children"]) == len(baked.atlas.charts) + len(cameras)
        assert ("rotation" in root) == turned
        if turned:
            x, _, _, w = root["rotation"]  # turns z to y
            assert (1 - 2 * x * x, -2 * x * w) == pytest.approx((0, 1))
