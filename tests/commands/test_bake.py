"""`gpf bake`: its files are what other programs read, and show what `gpf render` shows."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from gpf.cli import main
from gpf.core.images import read_exr, tone_map
from gpf.field.io import save_field
from gpf.field.lights import FieldLights
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.fingerprint import fingerprint
from gpf.scene.light_groups import LightGroups
from gpf.scene.load import load_scene_file
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.baking.known_light import field_with
from tests.commands.box import SOURCE

VIEW = View(name="eye", origin=(0.2, 0.1, 3.6), target=(0, -0.1, 0), fov=38)
SIZE, EXPOSURE = (48, 40), 1.2


def light(p: np.ndarray) -> np.ndarray:
    return 1.5 + np.sin(3 * p[:, [0]] + [0, 1, 2]) * np.cos(2 * p[:, [1]] - p[:, [2]])


def bake(*words: str) -> int:
    with pytest.raises(SystemExit) as outcome:
        main(["bake", "box.xml", *words])
    return outcome.value.code


def refused(capsys, *words: str) -> str:
    assert bake(*words) == 2
    return " ".join(capsys.readouterr().err.split())


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Path:
    """The Cornell Box, and a field whose light varies, in two groups."""
    folder = tmp_path_factory.mktemp("baked")
    shutil.copyfile(SOURCE / "scene.xml", folder / "box.xml")
    scene = load_scene_file(folder / "box.xml")
    field = field_with(scene, light)
    total = np.array(field.gaussians.irradiance).T
    groups = LightGroups(("light",), ((0,),))
    field.lights = FieldLights(groups, total[None])
    field.record = {"fingerprint": fingerprint(scene), "exposure": EXPOSURE}
    save_field(field, folder / "field.safetensors")
    return folder


def seen(index: dict, folder: Path) -> np.ndarray:
    """The light maps on the meshes, rendered by Mitsuba alone."""
    scene: dict = {"type": "scene", "integrator": {"type": "path", "max_depth": 1}}
    for name, shape in index["shapes"].items():
        image = {"type": "bitmap", "filename": str(folder / shape["map"]), "raw": True}
        scene[f"shape {name}"] = {
            "type": "ply",
            "filename": str(folder / shape["mesh"]),
            "emitter": {"type": "area", "radiance": {**image, "wrap_mode": "clamp"}},
        }
    return np.array(mi.render(mi.load_dict(scene), sensor=sensor(), spp=64))


def sensor() -> mi.Sensor:
    return make_sensor(VIEW, *SIZE, sampler="multijitter")


def test_light_maps_show_what_the_renderer_shows(box, capsys, two_threads):
    assert bake("--size", "512", "-o", "a") == 0
    said = capsys.readouterr().err
    assert "512x512, " in said and "texels per second" in said and "a: 8 meshes, " in said
    index = json.loads(Path("a/index.json").read_text())
    assert index["exposure"] == EXPOSURE and index["left_out"] == {}
    assert list(index["groups"]) == ["light"] and len(index["shapes"]) == 8
    scene = load_scene_file(box / "box.xml")
    settings = RenderSettings(adaptive=False, suppress_fireflies=False)
    field = field_with(scene, light)
    layers = FieldRenderer.make(scene, field, settings, ("irradiance", "albedo")).render(
        VIEW, SIZE, 0
    )
    albedo = layers["albedo"] / np.pi
    shown, expected = (
        tone_map(albedo * e, EXPOSURE) for e in (seen(index, box / "a"), layers["irradiance"])
    )
    assert expected.std() > 0.1
    assert -10 * np.log10(np.mean((shown - expected) ** 2)) > 40


def test_previews_are_the_maps_with_the_exposure(box):
    assert bake("--size", "64", "-o", "a", "--exposure", "0.7") == 0
    for stem in ("light", "light_light"):
        layers, record = read_exr(box / "a" / f"{stem}.exr")
        assert record["quantity"] == "irradiance, W/m²"
        with Image.open(box / "a" / f"{stem}.png") as preview:
            expected = np.round(255 * tone_map(layers["radiance"] / np.pi, 0.7))
            assert np.abs(np.asarray(preview) - expected).max() <= 1


def test_texels_per_unit(box):
    assert bake("--texels-per-unit", "20", "-o", "a") == 0
    width, height = json.loads(Path("a/index.json").read_text())["shapes"]["floor"]["size"]
    assert read_exr(box / "a" / "light.exr")[0]["radiance"].shape == (height, width, 3)
    assert 20**2 * 26 < width * height < 3 * 20**2 * 26


def test_vertex_colours(box):
    assert bake("--vertex-colours", "-o", "a") == 0
    index = json.loads(Path("a/index.json").read_text())
    assert not list((box / "a").glob("light*.exr")) and index["groups"] == ["light"]
    mesh = mi.load_dict({"type": "ply", "filename": "a/floor.ply"})
    points = np.array(mesh.vertex_positions_buffer()).reshape(-1, 3)
    text, _, body = Path("a/floor.ply").read_bytes().partition(b"end_header\n")
    lines = [line.split() for line in text.decode().splitlines()]
    kinds = [
        (w[2], {"float": "<f4", "uchar": "u1"}[w[1]])
        for w in lines
        if len(w) == 3 and w[0] == "property"
    ]
    rows = np.frombuffer(body, kinds, len(points))
    np.testing.assert_allclose(np.stack([rows[c] for c in "xyz"], 1), points)
    found = np.stack([rows[f"irradiance_{c}"] for c in "rgb"], axis=1)
    assert np.abs(found - light(points)).max() < 0.25
    colour = np.stack([rows[c] for c in ("red", "green", "blue")], axis=1)
    assert np.abs(colour - 255 * tone_map(found / np.pi, EXPOSURE)).max() <= 1


def test_the_scene_as_gltf_and_as_a_page(box, capsys):
    """Beside the maps; nothing is replaced unasked."""
    words = ("--size", "64", "-o", "a", "--glb", "box.glb", "--html", "pages/the_box.html")
    assert bake(*words) == 0
    said = capsys.readouterr().err
    assert "box.glb: 0.0 MB" in said and "the_box.html: 0." in said
    assert Path("box.glb").read_bytes()[:4] == b"glTF" and Path("a/light.exr").is_file()
    page = Path("pages/the_box.html").read_text()
    assert "<title>box</title>" in page and "Permission is hereby granted" in page
    assert not re.search("{(title|licence|parts)}", page) and len(page) < 700_000
    assert "http" not in re.sub("Permission.*?-->", "", page, flags=re.S).partition("<script")[2]
    shutil.rmtree("a")
    assert "box.glb: already exists" in refused(capsys, *words)
    assert not Path("a").exists()
    assert bake(*words, "--overwrite") == 0


def test_what_was_baked_before_is_kept(box, capsys):
    assert bake("--size", "64", "-o", "a") == 0
    before = Path("a/light.exr").read_bytes()
    assert "a/index.json: already exists. Add --overwrite" in refused(
        capsys, "--size", "80", "-o", "a"
    )
    assert Path("a/light.exr").read_bytes() == before
    assert bake("--size", "80", "-o", "a", "--overwrite") == 0
    assert Path("a/light.exr").read_bytes() != before


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--size 64 --vertex-colours", "--size and --vertex-colours: are mutually exclusive"),
        ("--glb a.glb --vertex-colours", "--glb and --vertex-colours: are mutually exclusive"),
        ("--html a.html --vertex-colours", "--html and --vertex-colours: are mutually exclusive"),
        ("--texels-per-unit 0", "--texels-per-unit 0.0: is out of range"),
        ("--exposure nan", "--exposure nan: is out of range"),
        ("--size 8", "Invalid value for '--size'"),
        ("--field missing.safetensors", "missing.safetensors: does not exist"),
        ("--size 64 --blend a.blend", "GPF_BLENDER=none: is neither Blender"),
    ],
)
def test_a_wrong_option_is_told_in_words(box, capsys, monkeypatch, words, told):
    monkeypatch.setenv("GPF_BLENDER", "none")
    assert told in refused(capsys, *words.split(), "-o", "a")
    assert not Path("a").exists()


def test_the_field_of_another_scene(box, capsys):
    text = Path("box.xml").read_text()
    Path("box.xml").write_text(text.replace('y="0.61"', 'y="0.5"'))
    assert "was fitted to another scene" in refused(capsys, "--size", "64", "-o", "a")
    assert bake("--size", "64", "-o", "a", "--changed-scene") == 0
