"""``<integrator type="sppm">`` as Mitsuba's users meet it: properties, films, variants, kernels."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.scene.bounds import scene_bounds
from tests.furnace import (
    bitmap,
    camera,
    diffuse,
    floor,
    furnace,
    point_light,
    rectangle,
    room,
    sppm,
)
from tests.plain_field import flat_gaussians, to_device

GAUZE = {"type": "mask", "opacity": 0.5, "nested": {"type": "twosided", "b": diffuse(0.5)}}
GLASS = {"type": "dielectric"}
PATH = {"type": "path", "max_depth": -1}


def small_scene(**film: object) -> mi.Scene:
    scene = furnace("point")
    scene["sensor"]["film"] |= film
    return mi.load_dict(scene)


def test_properties_are_read_from_xml():
    plugin = mi.load_string(
        """<integrator version="3.0.0" type="sppm">
             <integer name="passes" value="7"/>
             <integer name="photons_per_pass" value="1234"/>
             <float name="initial_radius" value="0.25"/>
             <float name="alpha" value="0.6"/>
             <integer name="max_depth" value="5"/>
             <integer name="rr_depth" value="3"/>
           </integrator>"""
    )
    assert str(plugin) == (
        "SPPM[passes=7, photons_per_pass=1234, initial_radius=0.25, alpha=0.6, max_depth=5, "
        "rr_depth=3]"
    )
    settings = plugin.settings(small_scene(), None, seed=0)
    assert (settings.photons_per_pass, settings.initial_radius) == (1234, 0.25)
    assert (settings.alpha, settings.max_depth, settings.rr_depth) == (0.6, 5, 3)


def test_defaults_of_the_plugin():
    assert str(mi.load_dict({"type": "sppm"})) == (
        "SPPM[passes=64, photons_per_pass=100000, initial_radius=0.0, alpha=0.7, max_depth=-1, "
        "rr_depth=5]"
    )


@pytest.mark.parametrize(
    ("properties", "words"),
    [
        ({"pases": 3}, 'unreferenced property .* "pases"'),
        ({"passes": 0}, '"passes" is 0; give a whole number of 1 or more'),
        ({"passes": 2.5}, '"passes" is 2.5; give a whole number'),
        ({"passes": "many"}, "\"passes\" is 'many'; give a whole number"),
        ({"photons_per_pass": -5}, '"photons_per_pass" is -5; give'),
        ({"photons_per_pass": 1e5}, '"photons_per_pass" is 100000.0; give a whole number'),
        ({"initial_radius": -0.1}, '"initial_radius" is -0.1; give a number of 0 or more'),
        ({"initial_radius": float("nan")}, '"initial_radius" is nan; give'),
        ({"initial_radius": float("inf")}, '"initial_radius" is inf; give'),
        ({"initial_radius": "auto"}, "\"initial_radius\" is 'auto'; give"),
        ({"alpha": 0.0}, '"alpha" is 0.0; give a number between 0 and 1'),
        ({"alpha": 1.0}, '"alpha" is 1.0; give a number between 0 and 1'),
        ({"alpha": "0.5"}, "\"alpha\" is '0.5'; give a number"),
        ({"max_depth": -2}, '"max_depth" is -2; give a whole number of -1 or more'),
        ({"max_depth": 2.5}, '"max_depth" is 2.5; give'),
        ({"rr_depth": 0}, '"rr_depth" is 0; give a whole number of 1 or more'),
        ({"hide_emitters": True}, '"hide_emitters" is not available in sppm'),
    ],
    ids=str,
)
def test_bad_properties_are_refused_in_words(properties, words):
    with pytest.raises(RuntimeError) as error:
        mi.load_dict({"type": "sppm"} | properties)
    assert re.search(words, str(error.value).replace("\n", " "))


def test_spp_overrides_passes():
    scene = small_scene()
    images = [
        mi.render(scene, integrator=mi.load_dict(sppm(5000, 0.2, passes=p)), spp=n, seed=4).numpy()
        for p, n in ((3, 0), (64, 3), (4, 0))
    ]
    np.testing.assert_allclose(images[0], images[1], rtol=1e-5)
    assert np.abs(images[0] - images[2]).max() > 1e-3


def test_seeds():
    scene, plugin = small_scene(), mi.load_dict(sppm(5000, 0.2, passes=2))
    one, again, other = (
        mi.render(scene, integrator=plugin, seed=seed).numpy() for seed in (1, 1, 2)
    )
    np.testing.assert_allclose(one, again, rtol=1e-5)
    assert np.abs(one - other).max() > 1e-3


@pytest.mark.parametrize("photons", [10_000, 160_000])
def test_the_automatic_radius_finds_16_photons(photons):
    """In the furnace the density of photons is the same all over."""
    scene = mi.load_dict(furnace("point", size=(48, 36)) | {"integrator": sppm(photons, 0)})
    settings = scene.integrator().settings(scene, scene.sensors()[0], seed=0)
    # Every path lands five times before roulette starts; then it keeps 1/32, a half, a half, …
    per_path = 5 + 0.5**5 * 2
    found = photons * per_path / (4 * np.pi) * np.pi * settings.initial_radius**2
    assert found == pytest.approx(16, rel=0.15)
    passes = max(2, 80_000 // photons)  # the mean has a standard error of 0.6 %
    assert mi.render(scene, spp=passes).numpy().mean() == pytest.approx(1, abs=0.02)


def test_a_far_horizon_does_not_change_the_automatic_radius():
    """Of a room that shows none of it."""
    far, found = floor(diffuse(0.5), z=-1, size=4e4), []
    for more in ({}, {"ground": far}):
        parts = {"room": room(diffuse(0.6)), "light": point_light((0, 0, 0.5), 3)}
        view = {"sensor": camera((-1, -0.8, 0.2), (1, 0.6, -0.2), 70, (24, 18))}
        scene = mi.load_dict({"type": "scene"} | parts | view | more)
        plugin = mi.load_dict(sppm(20_000, 0))
        found.append(plugin.settings(scene, scene.sensors()[0], seed=0).initial_radius)
    assert found[1] == pytest.approx(found[0], rel=0.02)


def test_the_automatic_radius_in_a_white_room():
    """The pilot pass has the longest walks there are."""
    scene = {"type": "scene", "room": room(diffuse(0.99)), "light": point_light((0, 0, 0), 1)}
    scene |= {"sensor": camera((0.1, 0, 0), (1, 0.2, 0)), "integrator": sppm(20_000, 0)}
    assert mi.render(mi.load_dict(scene), spp=2).numpy().min() > 0


def test_the_automatic_radius_where_no_light_falls():
    scene = {"type": "scene", "sensor": camera((0, -1, 1), (0, 0, 0)), "floor": floor(diffuse(0.5))}
    lights = {"light": point_light((0, 0, -1), 1), "integrator": sppm(5000, 0)}
    np.testing.assert_array_equal(mi.render(mi.load_dict(scene | lights), spp=2).numpy(), 0)


def emissive_picture(**film: object) -> tuple[mi.Scene, np.ndarray]:
    """A camera that sees one texel of a lamp in each pixel of its film; and what `path` sees."""
    picture = np.random.default_rng(2).uniform(0.1, 1, (6, 8, 3)).astype(np.float32)
    screen = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().scale([1, 0.75, 1]),
        "bsdf": diffuse(0),
        "emitter": {
            "type": "area",
            "radiance": bitmap(picture, filter_type="nearest", wrap_mode="clamp"),
        },
    }
    sensor = camera((0, 0, 1), (0, 0, 0), **film) | {"type": "orthographic"}
    del sensor["fov"]
    scene = mi.load_dict({"type": "scene", "screen": screen, "sensor": sensor})
    return scene, mi.render(scene, integrator=mi.load_dict(PATH), spp=1024).numpy()


def test_pixels_are_where_they_belong():
    """On an asymmetric film, where a swapped axis shows."""
    scene, expected = emissive_picture()
    assert expected.shape == (6, 8, 3) and np.ptp(expected) > 0.5
    image = mi.render(scene, integrator=mi.load_dict(sppm(100)), spp=4).numpy()
    np.testing.assert_allclose(image, expected, rtol=1e-4)


def test_crop_windows():
    _, whole = emissive_picture()
    crop = {"crop_offset_x": 2, "crop_offset_y": 1, "crop_width": 5, "crop_height": 3}
    scene, _ = emissive_picture(**crop)
    image = mi.render(scene, integrator=mi.load_dict(sppm(100)), spp=4).numpy()
    np.testing.assert_allclose(image, whole[1:4, 2:7], rtol=1e-4)


@pytest.mark.parametrize("border", [False, True])
def test_reconstruction_filters(border):
    """The samples are weighted with the film's own filter, at the film's edge too.

    A pixel has a standard error of 0.008.
    """
    film = {"rfilter": {"type": "gaussian", "stddev": 0.7}, "sample_border": border}
    scene, expected = emissive_picture(**film)
    image = mi.render(scene, integrator=mi.load_dict(sppm(100)), spp=32).numpy()
    np.testing.assert_allclose(image, expected, atol=0.06)
    plain = emissive_picture()[1]
    assert np.abs(expected - plain).max() > 0.2, "the filter makes no difference"


def test_the_alpha_channel_tells_surfaces_from_nothing():
    scene = {
        "type": "scene",
        "sensor": camera((0, 0, 3), (0, 0, 0), 60, pixel_format="rgba"),
        "sheet": rectangle((0, 0, 0), (0, 0, 1), 1, 1, diffuse(0.5)),
        "light": point_light((0, 0, 1), 1),
    }
    image = mi.render(mi.load_dict(scene | {"integrator": sppm(1000)}), spp=4).numpy()
    assert image.shape == (6, 8, 4)
    assert image[..., 3].max() == 1 and image[0, 0, 3] == 0


@pytest.mark.parametrize("kind", ["sppm", "gpf"])
def test_the_alpha_channel_is_that_of_path(kind):
    """A mirror that shows nothing, cloth, and a ball of glass, before nothing."""
    scene = {
        "type": "scene",
        "sensor": camera((0, 0, 3), (0, 0, 0), 60, pixel_format="rgba"),
        "mirror": rectangle((-0.8, 0, 0), (-0.8, 0, 1), 0.6, 1, {"type": "conductor"}),
        "cloth": rectangle((0, 0, 0), (0, 0, 1), 0.6, 1, GAUZE),
        "ball": {"type": "sphere", "center": [0.9, 0, 0], "radius": 0.4, "bsdf": GLASS},
        "light": point_light((0, 0, 1), 1),
    }
    if kind == "gpf":
        del scene["cloth"]  # both ways at once, whose alpha is that of the likelier
    loaded = mi.load_dict(scene)
    plugin = mi.load_dict({"type": "gpf"} if kind == "gpf" else sppm(1000, 0.1))
    if kind == "gpf":
        dark = flat_gaussians(np.zeros((1, 3)), np.zeros((1, 3)), size=5)
        settings = FieldSettings(search_radius=9)
        plugin.field = GaussianPhotonField(to_device(dark), settings, scene_bounds(loaded))
    found = mi.render(loaded, integrator=plugin, spp=256).numpy()[..., 3]
    expected = mi.render(loaded, integrator=mi.load_dict(PATH), spp=256).numpy()[..., 3]
    assert expected.min() == 0 and 0.8 < expected.max() <= 1
    np.testing.assert_allclose(found, expected, atol=0.15)
    assert found.mean() == pytest.approx(expected.mean(), abs=0.01)


def test_later_passes_run_the_kernels_of_the_first():
    """What changes from pass to pass must not be part of a kernel: compiling takes far longer."""
    scene, plugin = small_scene(), mi.load_dict(sppm(1000, 0.02))
    hashes = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for passes in (3, 9):
            dr.kernel_history_clear()
            mi.render(scene, integrator=plugin, spp=passes).numpy()
            kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
            hashes.append({k["hash"] for k in kernels})
    assert len(hashes[0]) > 5
    # Tables grow in powers of two: one step or two may lie between the passes.
    assert len(hashes[1] - hashes[0]) <= 2


# Each runs in a process of its own: here a variant has been set.
SCRIPTS = {
    "before a variant": """
        import gpf
        import mitsuba as mi
        assert mi.variant() is None, "importing gpf set a variant"
        mi.set_variant("llvm_ad_rgb")
        check()
    """,
    "after a variant": """
        import mitsuba as mi
        mi.set_variant("llvm_ad_rgb")
        import gpf
        assert mi.variant() == "llvm_ad_rgb"
        check()
    """,
    "across changes of variant": """
        import mitsuba as mi
        mi.set_variant("scalar_rgb")
        import gpf
        mi.set_variant("llvm_ad_rgb")
        check()
        mi.set_variant("scalar_rgb")
        mi.set_variant("llvm_ad_mono")
        try:
            mi.load_string(PLUGIN)
        except RuntimeError as error:
            assert "sppm needs an RGB variant; this one is llvm_ad_mono" in str(error)
        else:
            raise AssertionError("a monochrome variant was accepted")
        mi.set_variant("llvm_ad_rgb")
        check()
    """,
}

PREAMBLE = """
PLUGIN = '<integrator version="3.0.0" type="sppm"><integer name="passes" value="2"/></integrator>'
SCENE = '''<scene version="3.0.0">
  <integrator type="sppm">
    <integer name="photons_per_pass" value="2000"/> <float name="initial_radius" value="0.3"/>
  </integrator>
  <sensor type="perspective"> <film type="hdrfilm">
    <integer name="width" value="8"/> <integer name="height" value="6"/>
  </film> </sensor>
  <shape type="sphere"> <boolean name="flip_normals" value="true"/> </shape>
  <emitter type="point"> <rgb name="intensity" value="3.1416"/> </emitter>
</scene>'''

def check():
    import mitsuba as mi
    assert "passes=2" in str(mi.load_string(PLUGIN))
    image = mi.render(mi.load_string(SCENE), spp=4).numpy()
    assert image.shape == (6, 8, 3) and abs(image.mean() - 1) < 0.1, image.mean()
"""


@pytest.mark.parametrize("when", SCRIPTS)
def test_the_plugin_is_there(when):
    script = PREAMBLE + "\n".join(line[8:] for line in SCRIPTS[when].splitlines())
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=root,
        env=os.environ | {"PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
