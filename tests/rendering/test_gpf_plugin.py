"""``<integrator type="gpf">`` as Mitsuba's users meet it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from gpf.field.io import save_field
from tests.rendering.textured_floor import HEIGHT, WIDTH, E, constant_field, make_scene

PROJECT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("field") / "field.safetensors"
    save_field(constant_field(), path)
    return path


def test_the_plugin_loads_its_field_from_the_path_in_the_scene(saved):
    integrator = mi.load_string(
        f'<integrator version="3.0.0" type="gpf"><string name="field" value="{saved}"/>'
        '<integer name="max_depth" value="6"/><string name="aovs" value="coverage"/></integrator>'
    )
    text = str(integrator)
    assert "169 Gaussians" in text and "max_depth=6" in text and "search_radius=0.8" in text
    assert integrator.aov_names() == ["coverage"]
    image = np.array(mi.render(make_scene(), integrator=integrator, spp=2))
    assert image.shape == (HEIGHT, WIDTH, 4) and np.isfinite(image).all()


def test_a_missing_field_file_is_said_in_words(tmp_path):
    with pytest.raises(Exception, match=r"gone\.safetensors: is missing\. Check the path"):
        mi.load_dict({"type": "gpf", "field": str(tmp_path / "gone.safetensors")})


def test_no_field_at_all_is_said_in_words():
    with pytest.raises(RuntimeError) as caught:
        mi.render(make_scene(), integrator=mi.load_dict({"type": "gpf"}), spp=1)
    error: BaseException | None = caught.value
    words = []
    while error is not None:  # Dr.Jit wraps what happens inside a rendering
        words.append(str(error))
        error = error.__cause__
    assert 'has no field: set its "field" property to the path of a field.safetensors' in words[-1]


def test_an_unknown_property_is_refused():
    with pytest.raises(RuntimeError, match="filed"):
        mi.load_dict({"type": "gpf", "filed": "x"})


PROGRAM = """
import sys
import numpy as np
{first}
{second}
scene = mi.load_string('''
<scene version="3.0.0">
    <integrator type="gpf"><string name="field" value="{field}"/></integrator>
    <sensor type="perspective">
        <transform name="to_world">
            <lookat origin="1, 0, 4" target="1, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="8"/><integer name="height" value="6"/>
            <string name="pixel_format" value="rgb"/>
        </film>
    </sensor>
    <shape type="rectangle">
        <transform name="to_world"><scale x="4" y="3"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.25, 0.125"/></bsdf>
    </shape>
    <shape type="sphere">
        <point name="center" x="0" y="0" z="9"/>
        <emitter type="area"><rgb name="radiance" value="1"/></emitter>
    </shape>
</scene>''')
image = np.array(mi.render(scene, spp=1))
assert image.shape == (6, 8, 3), image.shape
print(*image.reshape(-1, 3).min(0), *image.reshape(-1, 3).max(0))
"""


@pytest.mark.parametrize("order", ["before", "after", "changed"])
def test_the_plugin_loads_whenever_the_variant_is_set(saved, order):
    # This process has told Dr.Jit where libLLVM is; its children inherit that.
    imports, variant = "import mitsuba as mi", f"mi.set_variant('{mi.variant()}')"
    first, second = {
        "before": (f"{imports}\nimport gpf", variant),
        "after": (f"{imports}\n{variant}", "import gpf"),
        "changed": (f"{imports}\nimport gpf\nmi.set_variant('scalar_rgb')", variant),
    }[order]
    program = PROGRAM.format(first=first, second=second, field=saved)
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=PROJECT, timeout=120
    )
    assert done.returncode == 0, done.stderr
    found = np.array(done.stdout.split(), dtype=float).reshape(2, 3)
    expected = np.array([0.5, 0.25, 0.125]) / np.pi * E
    np.testing.assert_allclose(found, [expected, expected], rtol=1e-4)
