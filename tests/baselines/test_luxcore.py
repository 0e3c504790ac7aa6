"""Translated scenes in LuxCore: what its scene files say, the light, and where it is."""

from __future__ import annotations

import array
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from baselines.luxcore.baseline import (
    HOST,
    VARIABLE,
    Luxcore,
    choices,
    configure,
    has_caustics,
)
from baselines.luxcore.scene import write_scene
from baselines.official import PROGRAMS, Program
from baselines.options import LuxcoreOptions
from baselines.peer import PreparedPeer
from baselines.protocol import CannotServe, Task
from baselines.translation.description import describe
from baselines.translation.nodes import read_dict
from gpf.core.files import read_json, write_text
from gpf.core.images import tone_map
from gpf.scene.load import load_scene_file
from gpf.scene.sensors import make_sensor, views_of_sensors
from tests.baselines.adapters import load_program
from tests.baselines.peer_pictures import compare, is_there
from tests.baselines.peer_scenes import LAMPS, MATERIALS, SCENES, at, glass, shown, stage
from tests.baselines.test_cycles import BOX, FOCUS
from tests.furnace import Scene, bitmap, diffuse, rgb


def written(folder: Path, **objects: Any) -> dict[str, str]:
    """The properties of a scene by their names."""
    scene = {"type": "scene"} | objects
    found = describe(read_dict(scene), mi.load_dict(scene, optimize=False), folder, "scene.xml")
    lines = write_scene(found, folder, "scene.xml").read_text().splitlines()
    return dict(line.split(" = ") for line in lines)


def sheet(bsdf: Scene, **more: Any) -> Scene:
    return {"type": "rectangle", "bsdf": bsdf} | more


def test_a_shape_that_shines_does_so_from_its_front(tmp_path: Path) -> None:
    lamp = {"type": "area", "radiance": rgb(3, 2, 1)}
    found = written(tmp_path, shape=sheet(diffuse(0.5, 0.25, 0.125), emitter=lamp))
    assert found["scene.materials.material_1.kd"] == "0.5 0.25 0.125"
    assert found["scene.materials.material_1.emission"] == "3 2 1"
    assert found["scene.materials.material_2.kd"] == "0 0 0"
    both = "scene.materials.material_3"
    assert found[f"{both}.frontmaterial"] == '"material_1"'
    assert found[f"{both}.backmaterial"] == '"material_2"'
    assert found["scene.objects.object_0.material"] == '"material_3"'
    assert Path(found["scene.objects.object_0.ply"].strip('"')).is_file()


def test_a_mirrored_copy_is_not_turned_inside_out(tmp_path: Path) -> None:
    group = {"type": "shapegroup", "id": "group", "box": {"type": "cube", "bsdf": diffuse(0.5)}}
    copy = {"type": "instance", "g": {"type": "ref", "id": "group"}}
    flip = at(("scale", (-1, 1, 1)), ("translate", (4, 0, 0)))
    found = written(
        tmp_path,
        group=group,
        first=copy | {"to_world": at(("translate", (2, 0, 0)))},
        second=copy | {"to_world": flip},
    )
    assert found["scene.objects.object_0.transformation"].split()[12:] == ["2", "0", "0", "1"]
    assert "scene.objects.object_1.transformation" not in found
    mesh = mi.load_dict({"type": "ply", "filename": found["scene.objects.object_1.ply"].strip('"')})
    scene = mi.load_dict({"type": "scene", "mesh": mesh})
    si = scene.ray_intersect(mi.Ray3f([0, 0.1, 0.2], [1, 0, 0]))
    np.testing.assert_allclose(np.ravel(si.n), (-1, 0, 0), atol=1e-6)
    np.testing.assert_allclose(np.ravel(si.p), (3, 0.1, 0.2), atol=1e-6)


def test_images_keep_their_place(tmp_path: Path) -> None:
    """Scaled, turned by 30 degrees and moved; LuxCore turns the other way."""
    to_uv = at(("scale", (2, 3, 1)), ("rotate", ((0, 0, 1), 30)), ("translate", (0.1, 0.2, 0)))
    texture = bitmap(np.full((2, 3, 3), 0.5), to_uv=to_uv)
    found = written(tmp_path, shape=sheet({"type": "diffuse", "reflectance": texture}))
    (name,) = {key.split(".")[2] for key in found if key.startswith("scene.textures")}
    mapping = {
        key: found[f"scene.textures.{name}.mapping.{key}"] for key in ("rotation", "uvscale")
    }
    assert float(mapping["rotation"]) == pytest.approx(-30, abs=1e-4)
    np.testing.assert_allclose([float(x) for x in mapping["uvscale"].split()], (2, 3), rtol=1e-5)


@pytest.mark.parametrize(
    ("bsdf", "reason"),
    [
        ({"type": "principled", "spec_trans": 0.5}, "transmit a part of the light"),
        (
            {"type": "principled", "spec_trans": 1.0, "base_color": {"type": "checkerboard"}},
            "textured principled",
        ),
    ],
)
def test_what_luxcore_lacks_is_named(tmp_path: Path, bsdf: Scene, reason: str) -> None:
    with pytest.raises(CannotServe, match=reason):
        written(tmp_path, shape=sheet(bsdf))


@pytest.mark.parametrize(
    ("bsdf", "expected"),
    [
        (diffuse(0.5), False),
        ({"type": "roughconductor", "material": "Au", "alpha": 0.2}, False),
        ({"type": "twosided", "bsdf": {"type": "conductor", "material": "Au"}}, True),
        ({"type": "mask", "opacity": 0.5, "bsdf": glass()}, True),
    ],
)
def test_caustics_come_from_smooth_glass_and_mirrors(tmp_path, bsdf, expected) -> None:
    written(tmp_path, shape=sheet(bsdf))
    assert has_caustics(read_json(tmp_path / "scene.json")) is expected


def test_settings_follow_the_caches() -> None:
    caustics, both = configure("caustics", 0.02, True), configure("both", 0.02, False)
    assert caustics["path.photongi.caustic.lookup.radius"] == 0.02
    assert caustics["path.hybridbackforward.enable"]
    assert not caustics["path.photongi.indirect.enabled"]
    assert both["path.photongi.indirect.enabled"] and both["path.photongi.caustic.enabled"]
    names = [str(settings.values()) for settings in (caustics, both)]
    assert ["INTEL_OIDN" in name for name in names] == [True, False]
    assert [choice["caches"] for choice in choices("indirect")] == [
        "indirect, 20 million photons",
        "indirect, 2 million photons",
        "indirect, 2 million photons, no denoiser",
        "none",
    ]


def test_titles() -> None:
    rows: list[dict[str, Any]] = [
        {"seconds": 60},
        {"seconds": "equal_time", "caches": "both"},
        {"seconds": 5, "caches": "none", "denoise": False},
    ]
    assert [LuxcoreOptions(system="luxcore", **row).title for row in rows] == [
        "LuxCore, 60 s",
        "LuxCore, equal time, both caches",
        "LuxCore, 5 s, no caches, no denoiser",
    ]


def test_without_luxcore_the_message_names_the_command(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("baselines.luxcore.baseline.find_spec", lambda name: None)
    monkeypatch.delenv(VARIABLE, raising=False)
    with pytest.raises(CannotServe, match=r"not installed: pyluxcore.*pip install --no-deps"):
        HOST.command()
    monkeypatch.setenv(VARIABLE, str(tmp_path / "nothing"))
    with pytest.raises(CannotServe, match="is not a program"):
        HOST.command()


def test_arrays_are_written_without_numpy(tmp_path, monkeypatch) -> None:
    monkeypatch.syspath_prepend(str(PROGRAMS))
    program = load_program("render_with_luxcore")
    values = np.arange(2 * 3 * 3, dtype=np.float32).reshape(2, 3, 3)
    program.write_npy(str(tmp_path / "a.npy"), array.array("f", values.ravel()), values.shape)
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), values[::-1])


needs_luxcore = pytest.mark.skipif(not is_there(HOST), reason=f"no LuxCore: {HOST.install}")
slow = pytest.mark.slow

# Energy and decibels of what is another model in LuxCore: rough metal and rough glass have
# Schlick's shadowing, panes a single reflection, `principled` Disney's own model.
OTHERS = {
    "rough_gold": (0.02, 32),
    "ggx": (0.02, 33),
    "frosted": (0.03, 28),
    "pane": (0.04, 27),
    "principled": (0.03, 33),
}


def start(task: Task, description: Path) -> PreparedPeer:
    scene = write_scene(read_json(description / "scene.json"), description, "scene")
    config = configure("none", 0.1, denoise=False) | {"sampler.sobol.adaptive.strength": 0.0}
    settings = {"scene": str(scene), "config": config}
    program = Program(HOST, "render_with_luxcore.py", settings, task.state)
    return PreparedPeer(task, program, 1.0, chosen={"config": {}})


def check(scene: Any, folder: Path, samples: int, other: Any = (0.02, 35), **more: Any) -> None:
    energy, decibels = compare(start, scene, folder, samples, **more)
    print(f"energy {energy:.3f}, {decibels:.1f} dB")
    assert energy == pytest.approx(1, abs=other[0]) and decibels > other[1]


@slow
@needs_luxcore
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", LAMPS)
def test_lamps(tmp_path, two_threads, name) -> None:
    check(stage(lamp=LAMPS[name]()), tmp_path, 64)


@slow
@needs_luxcore
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", MATERIALS)
def test_materials(tmp_path, two_threads, name) -> None:
    check(shown(MATERIALS[name]()), tmp_path, 64, OTHERS.get(name, (0.02, 35)))


@slow
@needs_luxcore
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", SCENES)
def test_scenes(tmp_path, two_threads, name) -> None:
    scene, view = SCENES[name]()
    check(scene, tmp_path, 128, view=view)


@slow
@pytest.mark.long
@needs_luxcore
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("name", "caches"), [("box", "indirect"), ("focus", "caustics")])
def test_a_view_with_caches_and_a_denoiser(tmp_path, two_threads, name, caches) -> None:
    file = BOX
    if name == "focus":
        file = tmp_path / "focus.xml"
        # A lamp of a size that Mitsuba's paths hit.
        write_text(file, FOCUS.replace('value="0.02"', 'value="0.3"').replace("5000", "30"))
    scene = load_scene_file(file)
    (view,) = views_of_sensors(scene)
    task = Task(name, scene, file, (48, 40), 1.0, (), 5, 1, tmp_path)
    prepared = Luxcore(LuxcoreOptions(system="luxcore", seconds=20)).prepare(task)
    image = prepared.render(view, 1)
    integrator = mi.load_dict({"type": "path", "max_depth": -1})
    sensor = make_sensor(view, *task.size)
    expected = mi.render(scene, integrator=integrator, sensor=sensor, spp=1024).numpy()
    ours, theirs = (tone_map(picture, 2.0) for picture in (expected, image))
    assert ((ours - theirs) ** 2).mean() < 10**-2.5
    np.testing.assert_allclose(theirs.mean(), ours.mean(), rtol=0.03)
    assert str(prepared.facts["version"]).startswith("LuxCore 2.")
    assert str(prepared.facts["caches"]).split(",")[0] in (caches, "none")
