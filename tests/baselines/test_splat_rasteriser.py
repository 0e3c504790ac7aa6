"""The rasteriser of splats against a plain twin, finite differences and gsplat."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from baselines.splatting.compositing import DENSEST, Compositor
from baselines.splatting.projection import (
    BLUR,
    FAINTEST,
    Projector,
    SplatArrays,
    harmonics,
    project,
)
from baselines.splatting.rasteriser import NAMES, Rasteriser
from baselines.splatting.tiles import TILE, sort_into_tiles
from gpf.core.structs import from_numpy
from gpf.scene.pinhole import Pinhole
from tests.baselines.splat_cases import SIZE, place_camera, random_splats


def draw(splats: dict, camera: Pinhole, degree: int) -> np.ndarray:
    width, height = camera.size
    image = Rasteriser(camera.size).draw(splats, camera, degree).image
    return np.array(image).reshape(height, width, 3)


def draw_plainly(splats: dict, camera: Pinhole) -> np.ndarray:
    """Gaussian by Gaussian over whole images, with a numerical Jacobian; harmonics of degree 0."""
    p = {name: value.detach().double().numpy() for name, value in splats.items()}
    width, height = camera.size
    grid = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
    image, through = np.zeros((height, width, 3)), np.ones((height, width))
    centres, depths = camera.project(p["means"])
    for i in np.argsort(depths):
        if depths[i] < 0.01:
            continue
        steps = 1e-4 * np.concatenate([np.eye(3), -np.eye(3)])
        ends, _ = camera.project(p["means"][i] + steps)
        jacobian = (ends[:3] - ends[3:]).T / 2e-4
        axes = Rotation.from_quat(p["quats"][i][[1, 2, 3, 0]]).as_matrix()
        root = jacobian @ axes * np.exp(p["scales"][i])
        inverse = np.linalg.inv(root @ root.T + BLUR * np.eye(2))
        away = grid - centres[i]
        bell = np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", away, inverse, away))
        alpha = bell / (1 + np.exp(-p["opacities"][i]))
        alpha = np.where(alpha < FAINTEST, 0, np.minimum(alpha, DENSEST))
        colour = np.maximum(0.5 + 0.28209479 * p["sh0"][i, 0], 0)
        image += (through * alpha)[..., None] * colour
        through *= 1 - alpha
    return image


def test_images_equal_a_plain_twins():
    splats, camera = random_splats(60, degree=0), place_camera()
    image = draw(splats, camera, 0)
    assert image.std() > 0.1
    np.testing.assert_allclose(image, draw_plainly(splats, camera), atol=2e-3)


def test_what_is_behind_the_camera_is_not_drawn():
    splats, camera = random_splats(60, degree=0), place_camera()
    before = draw(splats, camera, 0)
    with torch.no_grad():
        splats["means"][::2] += 2.5 * torch.tensor(camera.origin - splats["means"][0].numpy())
    image = draw(splats, camera, 0)
    assert abs(image - before).max() > 0.1
    np.testing.assert_allclose(image, draw_plainly(splats, camera), atol=2e-3)


def test_no_splat_in_sight_is_black():
    splats, camera = random_splats(5, degree=0), place_camera()
    with torch.no_grad():
        splats["means"] += 100
    drawing = Rasteriser(SIZE).draw(splats, camera, 0)
    assert not np.array(drawing.image).any()
    assert not drawing.info["radii"].any()
    drawing.backward(drawing.image + 1)
    assert all(not value.grad.any() for value in splats.values())


def test_lists_hold_each_tiles_footprints_by_depth():
    splats, camera = random_splats(40, degree=0), place_camera((27, 19))
    arrays = SplatArrays(*(from_numpy(mi.Float, splats[n].detach().numpy().ravel()) for n in NAMES))
    found = project(arrays, Projector.of(camera), 0)
    lists = sort_into_tiles(found, camera.size)
    centres, extents = np.array(found.centres).T, np.array(found.extents).T
    starts, indices, depths = (np.array(a) for a in (lists.starts, lists.indices, found.depths))
    across, down = lists.tiles
    assert (across, down) == (4, 3)
    for tile in range(across * down):
        low = TILE * np.array([tile % across, tile // across])
        meets = (extents[:, 0] > 0) & np.all(
            (centres + extents >= low) & (centres - extents < low + TILE), axis=1
        )
        expected = [i for i in np.argsort(depths) if meets[i]]
        assert indices[starts[tile] : starts[tile + 1]].tolist() == expected
    assert len(set(np.diff(starts).tolist())) > 3


@pytest.mark.parametrize("name", NAMES)
def test_gradients_equal_finite_differences(name, monkeypatch):
    # The cut of faint footprints makes the image jump where one moves.
    for module in ("projection", "compositing"):
        monkeypatch.setattr(f"baselines.splatting.{module}.FAINTEST", 1e-6)
    splats, camera = random_splats(30, degree=3), place_camera()
    adjoint = np.random.default_rng(1).normal(size=3 * SIZE[0] * SIZE[1])
    drawing = Rasteriser(SIZE).draw(splats, camera, 3)
    drawing.backward(from_numpy(mi.Float, adjoint))
    gradient = splats[name].grad.clone().ravel()
    scale = float(gradient.abs().max())
    assert scale > 0
    flat, step = splats[name].detach().view(-1), 5e-3 if name != "means" else 1e-3
    for i in gradient.abs().argsort(descending=True)[:24:3].tolist():
        ends = []
        for sign in (1, -1):
            flat[i] += sign * step
            ends.append(draw(splats, camera, 3).ravel() @ adjoint)
            flat[i] -= sign * step
        slope = (ends[0] - ends[1]) / (2 * step)
        assert slope == pytest.approx(float(gradient[i]), abs=0.01 * scale)


def test_gradients_of_centres_are_per_pixel(monkeypatch):
    """What the rule of densification goes by."""
    monkeypatch.setattr("baselines.splatting.compositing.FAINTEST", 1e-6)
    splats, camera = random_splats(30, degree=0), place_camera()
    adjoint = np.random.default_rng(1).normal(size=3 * SIZE[0] * SIZE[1])
    drawing = Rasteriser(SIZE).draw(splats, camera, 0)
    drawing.backward(from_numpy(mi.Float, adjoint))
    gradient = drawing.info["means2d"].grad[0].numpy()
    arrays = SplatArrays(*(from_numpy(mi.Float, splats[n].detach().numpy().ravel()) for n in NAMES))
    found = project(arrays, Projector.of(camera), 0)
    lists, scale = sort_into_tiles(found, SIZE), float(abs(gradient).max())
    for i in np.argsort(-abs(gradient).max(axis=1))[:5]:
        for axis in range(2):
            ends = []
            for sign in (1, -1):
                centres = np.array(found.centres)
                centres[axis, i] += sign * 0.01
                image = Compositor(replace(found, centres=mi.Vector2f(centres)), lists).image()
                ends.append(np.array(image) @ adjoint)
            slope = (ends[0] - ends[1]) / 0.02
            assert slope == pytest.approx(float(gradient[i, axis]), abs=0.01 * scale)


def test_harmonics_are_orthonormal():
    heights, weights = np.polynomial.legendre.leggauss(8)
    angles = np.arange(16) * np.pi / 8
    z, angle = (a.ravel() for a in np.meshgrid(heights, angles))
    r = np.sqrt(1 - z * z)
    directions = from_numpy(
        mi.Vector3f, np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    )
    values = np.array([np.array(dr.ones(mi.Float, len(z)) * v) for v in harmonics(directions, 3)])
    products = (values * np.tile(weights * np.pi / 8, 16)) @ values.T
    np.testing.assert_allclose(products, np.eye(16), atol=1e-5)


def test_footprints_and_colours_equal_those_of_gsplat():
    plain = pytest.importorskip("gsplat.cuda._torch_impl")
    splats, camera = random_splats(50, degree=3), place_camera()
    arrays = SplatArrays(*(from_numpy(mi.Float, splats[n].detach().numpy().ravel()) for n in NAMES))
    found = project(arrays, Projector.of(camera), 3)
    width, height = camera.size
    inner = torch.tensor([[camera.focal, 0, width / 2], [0, camera.focal, height / 2], [0, 0, 1.0]])
    p = {name: value.detach() for name, value in splats.items()}
    covariances, _ = plain._quat_scale_to_covar_preci(p["quats"], p["scales"].exp())
    _, centres, depths, conics, _ = plain._fully_fused_projection(
        p["means"],
        covariances,
        torch.tensor(np.linalg.inv(camera.pose), dtype=torch.float32)[None],
        inner[None].float(),
        width,
        height,
        eps2d=BLUR,
    )
    away = p["means"] - torch.tensor(camera.origin, dtype=torch.float32)
    coefficients = torch.cat([p["sh0"], p["shN"]], dim=1)
    colours = (plain._spherical_harmonics(3, away, coefficients) + 0.5).clamp_min(0)
    for ours, theirs in (
        (found.centres, centres[0]),
        (found.depths, depths[0]),
        (found.conics, conics[0]),
        (found.colours, colours),
    ):
        np.testing.assert_allclose(np.array(ours).T, theirs.numpy(), rtol=1e-3, atol=1e-4)
