"""Translated scenes in Cycles: the light, and where it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from baselines.cycles import HOST, Cycles
from baselines.official import Program
from baselines.options import CyclesOptions
from baselines.peer import PreparedPeer
from baselines.protocol import Task
from baselines.translation.description import describe
from baselines.translation.nodes import read_dict
from gpf.core.files import write_text
from gpf.core.images import tone_map
from gpf.scene.load import load_scene_file
from gpf.scene.sensors import make_sensor, views_of_sensors
from tests.baselines.peer_pictures import compare, is_there, picture_by
from tests.baselines.peer_scenes import (
    LAMPS,
    MATERIALS,
    SCENES,
    SIZE,
    VIEW,
    at,
    glass,
    shown,
    stage,
)
from tests.furnace import diffuse, rectangle

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(600),
    pytest.mark.skipif(not is_there(HOST), reason="no Blender: gpf blender-install"),
]


def start(task: Task, description: Path) -> PreparedPeer:
    settings = {"folder": str(description), "guiding": False, "caustics": False}
    program = Program(HOST, "render_with_cycles.py", settings, task.state)
    return PreparedPeer(task, program, 1.0, chosen={"denoiser": "none"})


def check(scene: Any, folder: Path, samples: int, **more: Any) -> None:
    energy, decibels = compare(start, scene, folder, samples, **more)
    print(f"energy {energy:.3f}, {decibels:.1f} dB")
    assert energy == pytest.approx(1, abs=0.02) and decibels > 35


@pytest.mark.parametrize("name", LAMPS)
def test_lamps(tmp_path, two_threads, name) -> None:
    check(stage(lamp=LAMPS[name]()), tmp_path, 32)


@pytest.mark.parametrize("name", MATERIALS)
def test_materials(tmp_path, two_threads, name) -> None:
    check(shown(MATERIALS[name]()), tmp_path, 48)


@pytest.mark.parametrize("name", SCENES)
def test_scenes(tmp_path, two_threads, name) -> None:
    scene, view = SCENES[name]()
    check(scene, tmp_path, 128, view=view)


BOX = Path(__file__).parents[2] / "scenes" / "cornell_box" / "scene.xml"


def test_a_view_with_guiding_and_a_denoiser(tmp_path, two_threads) -> None:
    scene = load_scene_file(BOX)
    (view,) = views_of_sensors(scene)
    task = Task("box", scene, BOX, (48, 40), 1.0, (), 5, 1, tmp_path)
    prepared = Cycles(CyclesOptions(system="cycles", seconds=6)).prepare(task)
    image = prepared.render(view, 1)
    integrator = mi.load_dict({"type": "path", "max_depth": -1})
    sensor = make_sensor(view, *task.size)
    expected = mi.render(scene, integrator=integrator, sensor=sensor, spp=1024).numpy()
    assert image.shape == (40, 48, 3) and image.dtype == np.float32
    ours, theirs = (tone_map(picture, 2.0) for picture in (expected, image))
    assert ((ours - theirs) ** 2).mean() < 10**-2.8
    np.testing.assert_allclose(theirs.mean(), ours.mean(), rtol=0.01)
    assert str(prepared.facts["version"]).startswith("Blender ")
    assert prepared.facts["denoiser"] in ("accurate", "fast", "none")


FOCUS = """
<scene version="3.0.0">
    <sensor type="perspective">
        <transform name="to_world">
            <lookat origin="0, -4, 3" target="0, 0, 0" up="0, 0, 1"/>
        </transform>
        <float name="fov" value="30"/>
    </sensor>
    <shape type="rectangle">
        <transform name="to_world"><scale value="2"/></transform>
        <bsdf type="diffuse"/>
    </shape>
    <shape type="sphere">
        <point name="center" x="0" y="0" z="1"/><float name="radius" value="0.5"/>
        <bsdf type="dielectric"/>
    </shape>
    <shape type="rectangle">
        <transform name="to_world">
            <scale value="0.02"/><rotate x="1" angle="180"/><translate z="4"/>
        </transform>
        <emitter type="area"><rgb name="radiance" value="5000"/></emitter>
    </shape>
</scene>
"""


def test_shadow_caustics_find_what_paths_miss(tmp_path, two_threads) -> None:
    """The light in the shadow of a ball of glass, from a lamp that paths hardly ever hit."""
    file = tmp_path / "scene.xml"
    write_text(file, FOCUS)
    scene = load_scene_file(file)
    (view,) = views_of_sensors(scene)
    found = []
    for caustics in (False, True):
        state = tmp_path / str(caustics)
        state.mkdir()
        task = Task("focus", scene, file, (48, 40), 1.0, (), 5, 1, state)
        options = CyclesOptions(
            system="cycles", seconds=4, denoise=False, guiding=False, shadow_caustics=caustics
        )
        found.append(Cycles(options).prepare(task).render(view, 1))
    brightest = [np.quantile(image[16:28, 18:30], 0.9) for image in found]
    assert brightest[1] > 3 * brightest[0]


def test_shadow_caustics_neither_add_light_nor_lose_it(tmp_path, two_threads) -> None:
    """A floor under a slab of glass, lit by a point and a sky, as photon mapping has it."""
    place = at(("scale", (4, 4, 0.2)), ("translate", (0, 0, 0.4)))
    scene = {
        "type": "scene",
        "floor": rectangle((0, 0, 0), (0, 0, 1), 8, 8, diffuse(0.6, 0.5, 0.4)),
        "slab": {"type": "cube", "to_world": place, "bsdf": glass()},
        "point": LAMPS["point"](),
        "sky": LAMPS["envmap"](),
    }
    loaded = mi.load_dict(scene, optimize=False)
    describe(read_dict(scene), loaded, tmp_path / "scene", "scene")
    settings = {"folder": str(tmp_path / "scene"), "guiding": False, "caustics": True}
    program = Program(HOST, "render_with_cycles.py", settings, tmp_path)
    task = Task("slab", loaded, tmp_path / "scene.xml", SIZE, 1.0, (), 5, 1, tmp_path)
    peer = PreparedPeer(task, program, 1.0, chosen={"denoiser": "none"})
    sppm = mi.load_dict({"type": "sppm", "passes": 60, "photons_per_pass": 200_000})
    expected = mi.render(loaded, integrator=sppm, sensor=make_sensor(VIEW, *SIZE), spp=60).numpy()
    image = picture_by(peer, VIEW, 128, 1)
    middle = np.s_[16:32, 24:48]
    assert image[middle].mean() == pytest.approx(expected[middle].mean(), rel=0.05)
