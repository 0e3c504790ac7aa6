"""A scene is loaded without its integrator: photon mapping has its own, and it may be unknown."""

from __future__ import annotations

import re

import mitsuba as mi
import numpy as np
import pytest

from gpf.cli import main
from gpf.core.errors import UserError
from gpf.scene.load import load_scene_file

SCENE = """\
<scene version="3.0.0">
    INTEGRATOR
    <sensor type="perspective">
        <film type="hdrfilm"><integer name="width" value="9"/></film>
    </sensor>
    <shape type="sphere" id="ball"><bsdf type="diffuse"/><emitter type="area"/></shape>
</scene>
"""
UNKNOWN = '<integrator type="guided_path"><integer name="budget" value="9"/></integrator>'
THEIR_SPPM = """<integrator type="sppm"><integer name="photon_count" value="9"/>
<integer name="max_passes" value="3"/><integer name="k_nn" value="8"/></integrator>"""
NESTED = f'<integrator type="aov"><string name="aovs" value="d:depth"/>{UNKNOWN}</integrator>'
STATISTICS = f'<integrator type="moment">{THEIR_SPPM}</integrator>'
NAMED = '<integrator type="guided_path" id="theirs"/>'
BY_NAME = f'{NAMED}<integrator type="moment"><ref id="theirs"/></integrator>'
TWICE = f'{NAMED}<ref id="theirs" name="again"/>'
OF_A_SENSOR = f'<sensor type="perspective">{UNKNOWN}</sensor>'
LOST_FIELD = '<integrator type="gpf"><string name="field" value="lost"/></integrator>'
OTHERS = '<include filename="part.xml"/>'
CASES = {
    "unknown": UNKNOWN,
    "their sppm": THEIR_SPPM,
    "nested": NESTED,
    "statistics": STATISTICS,
    "by name": BY_NAME,
    "twice": TWICE,
    "of a sensor": OF_A_SENSOR,
    "two": UNKNOWN + THEIR_SPPM,
    "field that is not there": LOST_FIELD,
}


def write(folder, integrator):
    file = folder / "scene.xml"
    file.write_text(SCENE.replace("INTEGRATOR", integrator))
    return file


@pytest.mark.parametrize("name", CASES)
def test_it_is_not_made(tmp_path, name):
    scene = load_scene_file(write(tmp_path, CASES[name]))
    assert scene.integrator() is None
    assert [shape.id() for shape in scene.shapes()] == ["ball"]
    assert scene.sensors()[-1].film().size()[0] == 9


@pytest.mark.parametrize("part", [UNKNOWN, f"<scene>{NESTED}</scene>"])
def test_nor_is_that_of_an_included_file(tmp_path, part):
    (tmp_path / "part.xml").write_text(re.sub(r"^<(\w+)", r'<\1 version="3.0.0"', part))
    assert load_scene_file(write(tmp_path, OTHERS)).integrator() is None


def test_what_others_share_with_it_is_made(tmp_path):
    shared = '<bsdf type="diffuse" id="red"><rgb name="reflectance" value="1,0,0"/></bsdf>'
    theirs = UNKNOWN.replace("</integrator>", f"{shared}</integrator>")
    file = write(tmp_path, theirs)
    file.write_text(file.read_text().replace('<bsdf type="diffuse"/>', '<ref id="red"/>'))
    red = mi.traverse(load_scene_file(file).shapes()[0].bsdf())["reflectance.value"]
    np.testing.assert_array_equal(np.array(red).ravel(), [1, 0, 0])


def test_what_is_wrong_with_the_rest_is_still_told(tmp_path):
    file = write(tmp_path, UNKNOWN)
    file.write_text(file.read_text().replace('"diffuse"', '"guided_bsdf"'))
    with pytest.raises(UserError, match=r"does not load: .*scene\.xml \(line 6.*guided_bsdf"):
        load_scene_file(file)


@pytest.mark.parametrize(
    ("integrator", "words"),
    [(UNKNOWN, r'Plugin "guided_path" not found'), (THEIR_SPPM, r'"photon_count"')],
)
def test_the_command_that_renders_with_it_tells_why_it_cannot(tmp_path, capfd, integrator, words):
    with pytest.raises(SystemExit) as outcome:
        main(["mitsuba", str(write(tmp_path, integrator)), "-o", str(tmp_path / "a.png")])
    assert outcome.value.code == 2
    assert words in capfd.readouterr().err.replace("\n", " ")


@pytest.mark.parametrize("kind", ["diffuse", "blendbsdf"])
def test_misspelt_names_are_still_told(tmp_path, kind):
    """Mitsuba refuses what nobody has read: looking for integrators is no reading."""
    both = '<bsdf type="diffuse"/><bsdf type="conductor"/><float name="weight" value="0.5"/>'
    rest = both if kind == "blendbsdf" else ""
    misspelt = f'<bsdf type="{kind}"><float name="wieght" value="1"/>{rest}</bsdf>'
    file = write(tmp_path, UNKNOWN)
    file.write_text(file.read_text().replace('<bsdf type="diffuse"/>', misspelt))
    with pytest.raises(UserError, match=r'unreferenced propert.*"wieght"'):
        load_scene_file(file)
