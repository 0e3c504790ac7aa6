"""The box around a scene, also where Mitsuba has merged some of its shapes."""

import mitsuba as mi
import numpy as np
import pytest

from gpf.scene.bounds import bounding_box

SCENE = """<scene version="3.0.0">
    <bsdf type="diffuse" id="grey"/>
    <shape type="rectangle"><ref id="grey"/></shape>
    <shape type="rectangle">
        <transform name="to_world"><translate x="3" y="0.5" z="2"/></transform>
        <ref id="grey"/>
    </shape>
    <shape type="sphere"><float name="radius" value="0.2"/></shape>
    {more}
    {light}
</scene>"""
CUBE = """<shape type="cube">
    <transform name="to_world"><scale value="0.3"/><translate x="1" z="1"/></transform>
    <ref id="grey"/>
</shape>"""
NEAR = '<emitter type="point"><point name="position" x="0" y="0" z="3"/></emitter>'
MAP = """<emitter type="sunsky">
    <transform name="to_world"><rotate x="1" angle="90"/></transform>
</emitter>"""
FAR = '<emitter type="constant"/><emitter type="directional"/>'


@pytest.fixture
def load(tmp_path):
    def from_file(light: str, optimize: bool, more: str = "") -> mi.Scene:
        file = tmp_path / "scene.xml"
        file.write_text(SCENE.format(light=light, more=more))
        return mi.load_file(str(file), optimize=optimize)

    return from_file


@pytest.mark.parametrize("more", ["", CUBE], ids=["", "with a cube"])
@pytest.mark.parametrize("optimize", [False, True])
def test_all_shapes_are_in_the_box(load, optimize, more):
    """A cube that is merged with rectangles has a box, which does not contain them."""
    box = bounding_box(load(NEAR, optimize, more))
    np.testing.assert_allclose(box, [[-1, -1, -0.2], [4, 1.5, 2]], atol=1e-6)


def test_a_scene_without_shapes():
    scene = mi.load_dict({"type": "scene", "light": {"type": "constant"}})
    np.testing.assert_array_equal(bounding_box(scene), 0)


@pytest.mark.parametrize("light", [NEAR, FAR, MAP], ids=["near", "far", "map"])
@pytest.mark.parametrize("more", ["", CUBE], ids=["", "with a cube"])
def test_merged_rectangles_look_as_they_do_apart(load, light, more):
    """Also in light from afar, which Mitsuba aims at its own box."""
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at([1.5, 0.2, 6], [1.5, 0.2, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 8, "height": 6, "rfilter": {"type": "box"}},
        }
    )
    sppm = mi.load_dict({"type": "sppm", "photons_per_pass": 50_000, "initial_radius": 0.2})
    merged, apart = (
        np.array(mi.render(load(light, optimize, more), sensor=sensor, integrator=sppm, spp=2))
        for optimize in (True, False)
    )
    assert (apart[:, :4] > 0.01).any() and (apart[:, 4:] > 0).any()
    np.testing.assert_allclose(merged, apart, rtol=1e-3, atol=1e-4)
