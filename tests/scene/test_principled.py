"""The plugins ``separable_principled`` and ``separable_principledthin``: Mitsuba's, taken apart."""

from __future__ import annotations

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.core.structs import from_numpy, to_numpy
from gpf.scene.load import load_scene_file
from gpf.scene.materials import (
    diffuse_context,
    diffuse_reflectance,
    diffuse_transfer,
    require_separable,
    specular_context,
)
from tests.furnace import bitmap, rgb

ROUGHNESS = bitmap(np.linspace(0.1, 1, 16).reshape(4, 4, 1))
KINDS = {
    "plain": {},
    "rough": {"roughness": 1.0},
    "a texture of roughness": {"roughness": ROUGHNESS},
    "metal and enamel": {"metallic": 0.6, "roughness": 0.3, "spec_tint": 0.4},
    "frosted": {"spec_trans": 0.4, "roughness": 0.5, "eta": 1.4},
    "lacquer": {"clearcoat": 1.0, "clearcoat_gloss": 0.8},
    "velvet": {"sheen": 1.0, "sheen_tint": 0.5, "roughness": 0.9},
    "flat": {"flatness": 1.0, "roughness": 0.7},
    "all": {
        "metallic": 0.2,
        "spec_trans": 0.2,
        "flatness": 0.5,
        "sheen": 0.5,
        "clearcoat": 0.5,
        "anisotropic": 0.5,
    },
}
THIN = {
    "paper": {"diff_trans": 0.8, "roughness": 0.7},
    "thin glass": {"spec_trans": 0.6, "roughness": 0.4, "eta": 1.4},
    "leaf": {"diff_trans": 1.3, "sheen": 0.6, "sheen_tint": 0.4, "flatness": 0.6},
    "a thin texture": {"diff_trans": 0.4, "roughness": ROUGHNESS, "spec_trans": 0.2},
}
EVERY = [*KINDS, *THIN]
COLOUR = {"base_color": rgb(0.7, 0.5, 0.2)}
N = 20_000


def load(kind: str, prefix: str = "separable_") -> mi.BSDF:
    name = prefix + ("principledthin" if kind in THIN else "principled")
    return mi.load_dict({"type": name} | COLOUR | (KINDS | THIN)[kind])


def pairs(seed: int = 3) -> tuple[mi.SurfaceInteraction3f, mi.Vector3f]:
    """Random places and pairs of directions, on both sides of the surface."""
    rng = np.random.default_rng(seed)
    w = rng.normal(size=(2, 3, N)).astype(np.float32)
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    si = dr.zeros(mi.SurfaceInteraction3f, N)
    si.t, si.wi = mi.Float(1), mi.Vector3f(w[0])
    si.uv = from_numpy(mi.Point2f, rng.random((N, 2)))
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    si.n = mi.Normal3f(0, 0, 1)
    return si, mi.Vector3f(w[1])


@pytest.mark.parametrize("kind", EVERY)
def test_all_components_together_are_principled(kind):
    ours, theirs = load(kind), load(kind, "")
    si, wo = pairs()
    context, rng = mi.BSDFContext(), np.random.default_rng(5)
    one, two = from_numpy(mi.Float, rng.random(N)), from_numpy(mi.Point2f, rng.random((N, 2)))
    for value, expected in (
        (ours.eval(context, si, wo), theirs.eval(context, si, wo)),
        (ours.pdf(context, si, wo), theirs.pdf(context, si, wo)),
        (ours.eval_pdf(context, si, wo)[0], theirs.eval(context, si, wo)),
        (ours.sample(context, si, one, two)[1], theirs.sample(context, si, one, two)[1]),
        (ours.eval_diffuse_reflectance(si), theirs.eval_diffuse_reflectance(si)),
    ):
        np.testing.assert_array_equal(value.numpy(), expected.numpy())
    assert ours.flags() == theirs.flags()


@pytest.mark.parametrize("kind", EVERY)
def test_the_diffuse_component_is_a_product_and_the_rest_is_not_negative(kind):
    bsdf = load(kind)
    si, wo = pairs()
    whole = to_numpy(load(kind, "").eval(mi.BSDFContext(), si, wo))
    diffuse = to_numpy(bsdf.eval(diffuse_context(), si, wo))
    rest = to_numpy(bsdf.eval(specular_context(), si, wo))
    assert diffuse.max() > 0.05 and np.all(diffuse <= whole * (1 + 1e-5) + 1e-6)
    np.testing.assert_allclose(diffuse + rest, whole, rtol=1e-5, atol=1e-6)
    # As the renderer takes it apart: g at a photon from wi, the reflectance at a camera ray to wo.
    photon, camera = mi.SurfaceInteraction3f(si), mi.SurfaceInteraction3f(si)
    camera.wi = wo
    sides = si.wi.z * wo.z > 0
    front = np.asarray((sides if kind in THIN else sides & (wo.z > 0)).numpy())
    product = diffuse_transfer(bsdf, photon, True) * diffuse_reflectance(bsdf, camera, True)
    found = to_numpy(product * dr.abs(wo.z) / dr.pi)[front]
    np.testing.assert_allclose(found, diffuse[front], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("kind", EVERY)
@pytest.mark.parametrize("context", ["diffuse", "rest"])
def test_samples_of_a_component_have_its_albedo(kind, context):
    """Against the sum over a fine grid of directions."""
    bsdf = load(kind)
    chosen = diffuse_context() if context == "diffuse" else specular_context()
    n, rng = 1 << 20, np.random.default_rng(2)
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi, si.t = dr.normalize(mi.Vector3f(0.5, 0.2, 0.6)), mi.Float(1)
    si.uv = mi.Point2f(0.3, 0.6)
    one, two = from_numpy(mi.Float, rng.random(n)), from_numpy(mi.Point2f, rng.random((n, 2)))
    sample, weight = bsdf.sample(chosen, si, one, two)
    directions = mi.warp.square_to_uniform_sphere(two)
    every = to_numpy(bsdf.eval(chosen, si, directions)).astype(float) * 4 * np.pi
    error = every.std(axis=0) / np.sqrt(n)
    difference = to_numpy(weight).astype(float).mean(axis=0) - every.mean(axis=0)
    assert np.all(np.abs(difference) < 4 * error + 0.002)
    density, given = (x.numpy() for x in (bsdf.pdf(chosen, si, sample.wo), sample.pdf))
    np.testing.assert_allclose(density[given > 0], given[given > 0], rtol=1e-3, atol=1e-5)


SCENE = """<scene version="3.0.0">
    <sensor type="perspective"><film type="hdrfilm"/></sensor>
    <emitter type="point"/>
    <shape type="sphere">$bsdf</shape>
</scene>"""


def test_scene_files_get_it_in_place_of_principled(tmp_path: Path):
    file = tmp_path / "scene.xml"
    bsdf = '<bsdf type="principled"/>'
    file.write_text(SCENE.replace("$bsdf", f'<bsdf type="twosided">{bsdf}</bsdf>'))
    assert "SeparablePrincipled[" in str(load_scene_file(file).shapes()[0].bsdf())
    file.write_text(SCENE.replace("$bsdf", '<bsdf type="principledthin"/>'))
    assert "SeparablePrincipledThin[" in str(load_scene_file(file).shapes()[0].bsdf())


@pytest.mark.parametrize("name", ["principled", "principledthin"])
def test_mitsubas_own_are_refused(name):
    """Of scenes that are not loaded from a file by this package."""
    scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": {"type": name}}})
    with pytest.raises(UserError, match=f"of type {name}, whose diffuse part .* separable_"):
        require_separable(scene)
