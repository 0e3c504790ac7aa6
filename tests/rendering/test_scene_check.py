"""A field is not rendered in another scene without a word."""

import json
import warnings

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

import gpf  # noqa: F401  # registers the plugins
from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.rendering.scene_check import warn_of_another_scene
from gpf.scene.bounds import bounding_box
from gpf.scene.fingerprint import changed_parts, fingerprint
from tests.plain_field import flat_gaussians, to_device

LOWER, UPPER = [-4.0, -3.0, 0.0], [4.0, 3.0, 2.0]

# Rectangles without material and emitter of their own are merged when a scene is loaded.
SCENE = """
<scene version="3.0.0">
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="1,0,4" target="1,0,0" up="0,1,0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="8"/><integer name="height" value="6"/>
        </film>
    </sensor>
    <bsdf type="diffuse" id="grey"/>
    <shape type="rectangle">
        <transform name="to_world"><scale x="4" y="3"/></transform><ref id="grey"/>
    </shape>
    <shape type="rectangle">
        <transform name="to_world"><translate z="2"/></transform><ref id="grey"/>
    </shape>
    <shape type="sphere">
        <point name="center" x="1" y="0" z="1"/><float name="radius" value="0.25"/>
        <emitter type="area"><rgb name="radiance" value="1"/></emitter>
    </shape>
</scene>"""


def load(optimize: bool = True) -> mi.Scene:
    return mi.load_string(SCENE, optimize=optimize)


def field(upper=UPPER) -> GaussianPhotonField:
    grid = np.stack(np.meshgrid(np.linspace(-4, 4, 9), np.linspace(-3, 3, 7), 0), -1)
    means = grid.reshape(-1, 3)
    g = to_device(flat_gaussians(means, np.ones((len(means), 3)), size=0.5))
    return GaussianPhotonField(g, FieldSettings(search_radius=1.5), (LOWER, upper))


@pytest.mark.parametrize("optimize", [True, False])
def test_the_bounding_box_is_whole(optimize):
    scene = load(optimize)
    np.testing.assert_allclose(bounding_box(scene), [LOWER, UPPER], atol=1e-6)
    # Why it is not taken from the scene itself.
    assert np.allclose(scene.bbox().max, UPPER) != optimize
    warn_of_another_scene(scene, [LOWER, UPPER])


@pytest.mark.parametrize("optimize", [True, False])
@pytest.mark.parametrize("fitted", [True, False])
def test_a_scene_is_the_same_merged_or_not(optimize, fitted):
    known = json.loads(json.dumps(fingerprint(load(fitted))))
    assert changed_parts(known, fingerprint(load(optimize))) == []
    warn_of_another_scene(load(optimize), [LOWER, UPPER], known)
    # As an earlier version wrote it, it cannot be compared.
    warn_of_another_scene(load(optimize), [LOWER, UPPER], dict.fromkeys(known, "0123"))


@pytest.mark.parametrize(
    ("old", "new", "other"),
    [
        ('<point name="center" x="1" y="0"', '<point name="center" x="0" y="0"', "lights"),
        ('<rgb name="radiance" value="1"/>', '<rgb name="radiance" value="1,1,0.9"/>', "lights"),
        (
            'type="diffuse" id="grey"/>',
            'type="diffuse" id="grey"><rgb name="reflectance" value=".2"/></bsdf>',
            "materials",
        ),
        ('<translate z="2"/>', '<scale value=".9"/><translate z="2"/>', "geometry"),
    ],
)
@pytest.mark.parametrize("optimize", [True, False])
def test_what_changes_within_the_same_box_is_told(old, new, other, optimize):
    """A lamp that moves, or is of another colour; another material; a smaller wall."""
    changed = mi.load_string(SCENE.replace(old, new), optimize=optimize)
    integrator = mi.load_dict({"type": "gpf"})
    integrator.field = field()
    integrator.field.record = {"fingerprint": fingerprint(load())}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mi.render(load(), integrator=integrator, spp=1)
    words = f"before it was changed: different .*{other}.* The image shows the earlier light"
    with pytest.warns(UserWarning, match=words):
        mi.render(changed, integrator=integrator, spp=1)


def test_thicker_fog_is_told():
    box = '<shape type="cube"><bsdf type="null"/><medium type="homogeneous" name="interior">{}'
    box += "</medium></shape></scene>"
    parts = [
        fingerprint(mi.load_string(SCENE.replace("</scene>", box.format(what))))
        for what in ("", '<float name="sigma_t" value="2"/>', '<phase type="hg"/>')
    ]
    assert changed_parts(parts[0], parts[0]) == []
    assert [changed_parts(parts[0], part) for part in parts[1:]] == [["materials"]] * 2


@pytest.mark.parametrize("corner", [0, 1])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_tolerance_is_a_thousandth_of_the_diagonal(corner, axis):
    scene, bounds = load(), np.array([LOWER, UPPER])
    diagonal = np.linalg.norm(bounds[1] - bounds[0])
    bounds[corner, axis] += 0.9e-3 * diagonal
    warn_of_another_scene(scene, bounds.tolist())
    bounds[corner, axis] += 0.3e-3 * diagonal
    with pytest.warns(UserWarning, match="made for another scene"):
        warn_of_another_scene(scene, bounds.tolist())


@pytest.mark.parametrize("record", [False, True])
def test_the_integrator_warns_once_for_each_scene_and_goes_on(record):
    scene, other = load(), load()
    integrator = mi.load_dict({"type": "gpf", "record": record})
    integrator.field = field(upper=[4.0, 3.0, 3.5])
    words = (
        r"This field was made for another scene: that scene extends from \(-4, -3, 0\) to "
        r"\(4, 3, 3\.5\), this one from \(-4, -3, 0\) to \(4, 3, 2\)\."
    )
    with pytest.warns(UserWarning, match=words) as caught:
        images = [np.array(mi.render(scene, integrator=integrator, spp=2)) for _ in range(3)]
    assert len(caught) == 1
    assert images[0][..., :3].min() > 0
    # A GPU adds up the samples of a pixel in any order.
    np.testing.assert_allclose(images[0], images[2], rtol=1e-6)
    with pytest.warns(UserWarning, match="made for another scene"):
        mi.render(other, integrator=integrator, spp=2)
    integrator.field = field()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dr.eval(mi.render(other, integrator=integrator, spp=2))


def test_hair_and_instances_are_compared(tmp_path):
    """Mitsuba does not know the area of either."""
    strand = tmp_path / "strand.txt"

    def known(*, x: float) -> dict[str, object]:
        strand.write_text(f"0 0 0 .1\n1 0 0 .1\n2 0 0 .1\n{x} 1 0 .1\n")
        return fingerprint(
            mi.load_dict(
                {
                    "type": "scene",
                    "hair": {"type": "bsplinecurve", "filename": str(strand)},
                    "group": {"type": "shapegroup", "ball": {"type": "sphere"}},
                    "copy": {"type": "instance", "group": {"type": "ref", "id": "group"}},
                }
            )
        )

    first = known(x=3)
    assert changed_parts(first, known(x=3)) == []
    assert "geometry" in changed_parts(first, known(x=6))


def test_names_of_texture_files_do_not_matter(tmp_path):
    def known(name, level):
        file = tmp_path / f"{name}.png"
        Image.fromarray(np.full((4, 4, 3), level, np.uint8)).save(file)
        texture = {"type": "bitmap", "filename": str(file)}
        wall = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": texture}}
        return fingerprint(mi.load_dict({"type": "scene", "wall": wall}))

    assert changed_parts(known("one", 100), known("other", 100)) == []
    assert changed_parts(known("one", 100), known("other", 101)) == ["materials"]
