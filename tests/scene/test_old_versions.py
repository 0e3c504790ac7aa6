"""Scene files of Mitsuba 0.5, 0.6 and 2 show what the same scene shows when it is written for 3."""

from __future__ import annotations

import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from gpf.cli import main
from gpf.core.errors import UserError
from gpf.scene.load import load_scene_file
from gpf.scene.sensors import views_of_sensors

OLD = """\
<?xml version="1.0" encoding="utf-8"?>
<scene version="0.6.0">
    <default name="resx" value="16"/>
    <default name="tilt" value="-90"/>
    <integrator type="path">
        <integer name="maxDepth" value="6"/>
        <boolean name="strictNormals" value="true"/>
    </integrator>
    <sensor type="perspective">
        <float name="fov" value="40"/>
        <string name="fovAxis" value="y"/>
        <float name="nearClip" value="0.01"/>
        <float name="farClip" value="100"/>
        <transform name="toWorld">
            <lookat origin="0.5, 2, 6" target="0, 0.5, 0" up="0, 1, 0"/>
        </transform>
        <sampler type="independent"><integer name="sampleCount" value="4"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="$resx"/>
            <integer name="height" value="9"/>
            <string name="pixelFormat" value="rgb"/>
            <string name="componentFormat" value="float32"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <bsdf type="twosided" id="wall">
        <bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.4, 0.2"/></bsdf>
    </bsdf>
    <alias id="wall" as="floor"/>
    <bsdf type="roughdielectric" id="frosted">
        <string name="distribution" value="ggx"/>
        <float name="alpha" value="0.05"/>
        <string name="intIOR" value="bk7"/>
        <float name="extIOR" value="1.0"/>
    </bsdf>
    <bsdf type="roughplastic" id="gloss">
        <spectrum name="diffuseReflectance" value="0.4"/>
        <float name="intIOR" value="1.7"/>
        <boolean name="nonlinear" value="true"/>
    </bsdf>
    <bsdf type="diffuse" id="tiles">
        <texture name="diffuseReflectance" type="checkerboard">
            <rgb name="color0" value="0.9 0.1 0.1"/>
            <spectrum name="color1" value="0.2"/>
            <float name="uscale" value="3"/>
            <float name="vscale" value="2"/>
            <float name="uoffset" value="0.25"/>
        </texture>
    </bsdf>
    <bsdf type="mask" id="holes">
        <spectrum name="opacity" value="0.6"/>
        <bsdf type="roughconductor">
            <string name="material" value="Cu"/>
            <float name="alphaU" value="0.1"/>
            <float name="alphaV" value="0.3"/>
        </bsdf>
    </bsdf>
    <shape type="rectangle">
        <transform name="toWorld">
            <scale x="4" y="4"/><rotate x="1" angle="$tilt"/>
        </transform>
        <ref id="floor"/>
    </shape>
    <shape type="rectangle">
        <boolean name="flipNormals" value="false"/>
        <transform name="toWorld">
            <matrix value="4 0 0 0 0 4 0 2 0 0 4 -3 0 0 0 1"/>
        </transform>
        <ref name="bsdf" id="tiles"/>
    </shape>
    <shape type="sphere">
        <point name="center" x="-1.2" y="0.6" z="1"/>
        <float name="radius" value="0.6"/>
        <ref id="frosted"/>
    </shape>
    <shape type="cube">
        <transform name="toWorld">
            <scale value="0.5"/><rotate y="1" angle="30"/><translate x="0.4" y="0.5"/>
        </transform>
        <ref id="gloss"/>
    </shape>
    <shape type="ply">
        <string name="filename" value="wedge.ply"/>
        <boolean name="faceNormals" value="true"/>
        <ref id="holes"/>
    </shape>
    <include filename="lamps.xml"/>
</scene>
"""
OLD_LAMPS = """\
<scene version="0.5.0">
    <emitter type="spot">
        <transform name="toWorld">
            <lookat origin="0, 4, 3" target="0, 0, 0" up="0, 0, 1"/>
        </transform>
        <spectrum name="intensity" value="30"/>
        <float name="cutoffAngle" value="40"/>
        <float name="beamWidth" value="25"/>
    </emitter>
    <shape type="disk">
        <transform name="toWorld"><rotate x="1" angle="90"/><translate y="3.5"/></transform>
        <emitter type="area"><rgb name="radiance" value="5, 6, 8"/></emitter>
    </shape>
</scene>
"""
WEDGE = """\
ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
1 0 1.5
2 0 1
1.5 1 1
1 1 0.5
3 0 1 2
3 0 2 3
"""


OLD_UV = """\
            <float name="uscale" value="3"/>
            <float name="vscale" value="2"/>
            <float name="uoffset" value="0.25"/>
"""
NEW_UV = """\
            <transform name="to_uv"><translate x="0.25"/><scale x="3" y="2"/></transform>
"""


def renew(text: str, version: str = "3.0.0") -> str:
    """The same as one writes it for Mitsuba 3."""
    text = text.replace('name="diffuseReflectance" type', 'name="reflectance" type')
    text = re.sub(r'(?<=name=")\w+', _in_snake_case, text.replace(OLD_UV, NEW_UV))
    return re.sub(r'(?<=scene version=")[\d.]+', version, text)


def _in_snake_case(name: re.Match[str]) -> str:
    return re.sub(r"(?<=[a-z])[A-Z]+", lambda found: f"_{found[0].lower()}", name[0])


def write(folder: Path, text: str, lamps: str) -> Path:
    folder.mkdir()
    (folder / "wedge.ply").write_text(WEDGE)
    (folder / "lamps.xml").write_text(lamps)
    (folder / "scene.xml").write_text(text)
    return folder / "scene.xml"


def picture(file: Path) -> np.ndarray:
    scene = load_scene_file(file, 16, 9)
    path = mi.load_dict({"type": "path", "max_depth": 6})
    return np.array(mi.render(scene, integrator=path, sensor=0, seed=1, spp=4))


@pytest.mark.parametrize(
    ("text", "lamps"),
    [
        (OLD, OLD_LAMPS),
        (OLD.replace("0.6.0", "0.5.0"), OLD_LAMPS.replace("0.5.0", "0.6.0")),
        (OLD, renew(OLD_LAMPS)),
        (renew(OLD), OLD_LAMPS),
        (renew(OLD, "2.1.0"), renew(OLD_LAMPS, "2.0.0")),
    ],
    ids=["0.6 and 0.5", "0.5 and 0.6", "0.6 and 3", "3 and 0.5", "2"],
)
def test_the_picture_is_that_of_the_new_scene(tmp_path, text, lamps):
    new = write(tmp_path / "new", renew(OLD), renew(OLD_LAMPS))
    wanted = picture(new)
    assert (wanted > 0.01).mean() > 0.5
    old = write(tmp_path / "old", text, lamps)
    np.testing.assert_array_equal(picture(old), wanted)
    views = [views_of_sensors(load_scene_file(file)) for file in (old, new)]
    assert views[0] == views[1]


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("<lookat", "<lookAt", '<transform name="toWorld">', "unexpected <lookAt> element inside"),
        ('<rgb name="color0"', "<srgb", "<srgb", "unsupported XML element: <srgb>"),
        ('"hdrfilm"', '"ldrfilm"', "<film", 'Plugin "ldrfilm" not found'),
        ('type="independent"', 'type="sobol"', "<sampler", 'Plugin "sobol" not found'),
        ("nonlinear", "noLines", '<bsdf type="roughplastic"', 'unreferenced property .*"no_lines"'),
    ],
)
def test_what_mitsuba_does_not_take_is_told_with_its_line(tmp_path, old, new, place, words):
    text = OLD.replace(old, new)
    line = text[: text.index(place)].count("\n") + 1
    file = write(tmp_path / "old", text, OLD_LAMPS)
    with pytest.raises(UserError, match=rf"scene\.xml \(line {line}, .*{words}") as told:
        load_scene_file(file)
    assert "In old scenes, Mitsuba 3 renames only the parameters" in told.value.todo
    file.write_text(renew(text))
    (tmp_path / "old/lamps.xml").write_text(renew(OLD_LAMPS))
    with pytest.raises(UserError) as told:
        load_scene_file(file)
    assert told.value.todo == "Correct the scene file."


def test_parameters_can_be_given_as_in_new_scenes(tmp_path):
    strict = '<boolean name="strictNormals" value="true"/>'  # Mitsuba 3 has none
    file = write(tmp_path / "old", OLD.replace(strict, ""), OLD_LAMPS)
    picture = tmp_path / "a.png"
    with pytest.raises(SystemExit) as outcome:
        main(["mitsuba", str(file), "-D", "resx=12", "-o", str(picture)])
    assert outcome.value.code == 0
    assert [*mi.Bitmap(str(picture)).size()] == [12, 9]
