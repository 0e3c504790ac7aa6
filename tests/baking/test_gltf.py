"""Binary glTF: what the files say is what the scene is."""

from __future__ import annotations

import io
import json
import struct

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from gpf.baking.albedo import read_albedo
from gpf.baking.atlas import unwrap
from gpf.baking.finish import read_finish, read_gloss
from gpf.baking.gltf import Stage, write_glb
from gpf.baking.reflectance import bake_radiosity
from gpf.baking.surfaces import read_specular_surfaces, read_surfaces
from gpf.core.images import tone_map, undo_tone_map
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.baking.known_light import DIFFUSE, look_up, on_triangles
from tests.baking.showroom import ASPECT, EXPOSURE, VIEWS, bake_showroom, grouped_field, showroom

TYPES = {5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}


class Read:
    """A file, read as the specification says."""

    def __init__(self, data: bytes) -> None:
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON" and size % 4 == 0
        self.content = json.loads(data[20 : 20 + size])
        rest, kind = struct.unpack_from("<I4s", data, 20 + size)
        assert kind == b"BIN\0" and rest % 4 == 0 and 28 + size + rest == len(data)
        self.buffer = data[28 + size :]
        assert 0 <= rest - self.content["buffers"][0]["byteLength"] < 4

    def view(self, index: int) -> bytes:
        view = self.content["bufferViews"][index]
        assert view["byteOffset"] % 4 == 0
        end = view["byteOffset"] + view["byteLength"]
        assert end <= self.content["buffers"][0]["byteLength"]
        return self.buffer[view["byteOffset"] : end]

    def values(self, index: int) -> np.ndarray:
        accessor = self.content["accessors"][index]
        values = np.frombuffer(self.view(accessor["bufferView"]), TYPES[accessor["componentType"]])
        values = values.reshape(accessor["count"], WIDTHS[accessor["type"]])
        for name, bound in (("min", values.min(axis=0)), ("max", values.max(axis=0))):
            np.testing.assert_array_equal(accessor.get(name, bound), bound)
        return values

    def image(self, texture: dict) -> np.ndarray:
        source = self.content["textures"][texture["index"]]["source"]
        image = self.content["images"][source]
        with Image.open(io.BytesIO(self.view(image["bufferView"]))) as opened:
            assert image["mimeType"] == f"image/{opened.format.lower()}"
            return np.asarray(opened)

    def part(self, name: str) -> tuple[dict[str, np.ndarray], np.ndarray, dict]:
        """The properties of a mesh's vertices, its triangles and its material."""
        (node,) = (n for n in self.content["nodes"] if n["name"] == name)
        (primitive,) = self.content["meshes"][node["mesh"]]["primitives"]
        attributes = {k: self.values(v) for k, v in primitive["attributes"].items()}
        faces = self.values(primitive["indices"]).reshape(-1, 3)
        assert faces.max() < len(attributes["POSITION"])
        return attributes, faces, self.content["materials"][primitive["material"]]


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
    ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(place.T), mi.Point2f(0.5))
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


def single(**shape) -> mi.Scene:
    return mi.load_dict({"type": "scene", "it": {"type": "rectangle", **shape}})


@pytest.mark.parametrize("wrap", ["repeat", "mirror", "clamp"])
def test_an_image_keeps_its_own_resolution(wrap):
    pixels = np.random.default_rng(0).uniform(0, 1, (7, 9, 3)).astype(np.float32)
    image = {"type": "bitmap", "data": mi.TensorXf(pixels), "raw": True, "wrap_mode": wrap}
    image["to_uv"] = mi.ScalarTransform4f().rotate([0, 0, 1], 20).scale([3, 2, 1])
    (surface,), _ = read_surfaces(single(bsdf={"type": "diffuse", "reflectance": image}))
    albedo = read_albedo(surface)
    assert albedo.wrap == wrap and albedo.image.shape == pixels.shape
    np.testing.assert_allclose(albedo.factor, 1, atol=1e-3)
    assert np.abs(undo_tone_map(albedo.image / 255) - pixels).max() < 0.006


def test_what_is_no_single_image_is_baked():
    squares = {"type": "diffuse", "reflectance": {"type": "checkerboard"}}
    (surface,), _ = read_surfaces(single(bsdf=squares))
    assert read_albedo(surface) is None
    (surface,), _ = read_surfaces(single(bsdf=DIFFUSE))
    albedo = read_albedo(surface)
    assert albedo.image is None
    np.testing.assert_allclose(albedo.factor, [0.5, 0.4, 0.3], rtol=1e-5)


def finish(**bsdf):
    (surface,) = read_specular_surfaces(single(bsdf=bsdf))
    return read_finish(surface)


def test_finishes():
    mirror = finish(type="conductor", material="none")
    assert (mirror.colour > 0.99).all() and mirror.roughness == 0 and not mirror.transmits
    pane = finish(type="thindielectric", int_ior=1.5, ext_ior=1.0)
    assert pane.transmits and not pane.bends
    tinted = finish(
        type="roughdielectric", alpha=0.04, specular_transmittance=0.5, int_ior=1.3, ext_ior=1.0
    )
    assert tinted.bends and tinted.roughness == pytest.approx(0.2)
    np.testing.assert_allclose(tinted.colour, 0.5, atol=0.03)
    inside = finish(type="dielectric", int_ior=1.0, ext_ior=1.5)
    assert inside.ior == pytest.approx(1.5, abs=1e-4)
    squares = {"type": "checkerboard", "color0": 0.2, "color1": 0.9}
    floor = finish(type="conductor", material="none", specular_reflectance=squares)
    assert floor.colour.ndim == 3
    np.testing.assert_allclose(
        floor.colour[[100, 100, 400], [100, 400, 400], 0], [0.2, 0.9, 0.2], atol=0.01
    )


def test_water_is_darker_than_what_is_in_it():
    """Radiance falls by the square of the index of refraction where light leaves the water."""
    over = mi.ScalarTransform4f().translate([0, 0, 0.4])
    water = {
        "type": "rectangle",
        "to_world": over,
        "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
    }
    scene = mi.load_dict(
        {"type": "scene", "water": water, "floor": {"type": "rectangle", "bsdf": DIFFUSE}}
    )
    baked_floor = read_surfaces(scene)[0]
    stage = Stage(scene, unwrap(baked_floor, 32), read_specular_surfaces(scene), [], 1)
    file = Read(write_glb(stage, np.zeros((32, 32, 3), np.uint8), 1))
    _, _, material = file.part("water")
    assert material["pbrMetallicRoughness"]["baseColorFactor"][0] == pytest.approx(
        1 / 2.25, abs=0.01
    )
    assert material["extensions"]["KHR_materials_volume"]["thicknessFactor"] == pytest.approx(
        0.4, abs=1e-3
    )


def test_a_metal_that_is_principled_is_no_black_surface():
    metal = {"type": "separable_principled", "metallic": 1.0, "roughness": 0.25}
    metal["base_color"] = {"type": "rgb", "value": [0.9, 0.6, 0.3]}
    scene = single(bsdf=metal)
    (surface,), _ = read_surfaces(scene)
    assert read_gloss(surface) == 0.25
    stage = Stage(scene, unwrap([surface], 32), [], [], 1)
    _, _, material = Read(write_glb(stage, np.zeros((32, 32, 3), np.uint8), 1)).part("it")
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 1
    np.testing.assert_allclose(
        material["pbrMetallicRoughness"]["baseColorFactor"][:3], [0.9, 0.6, 0.3], atol=0.1
    )
