"""Hash grids and networks: what they compute, and that gradients reach their parameters."""

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from baselines.neural.hash_encoding import Cube, GridShape, HashGrid, Network
from gpf.core.structs import from_numpy

# Half precision, which networks have on CUDA, is too coarse for differences.
needs_llvm = pytest.mark.skipif(
    dr.backend_v(mi.Float) == dr.JitBackend.CUDA, reason="half precision on CUDA"
)


def points(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.05, 0.95, (count, 3)).astype(np.float32)


def ask(grid: HashGrid, x: np.ndarray) -> np.ndarray:
    """Features at points, (N, levels × features)."""
    return np.array([f.numpy() for f in grid(from_numpy(mi.Point3f, x))]).T


def test_a_grid_interpolates_between_the_vertices_of_each_level():
    """A dense level whose features are linear functions of its vertices' places gives just these.

    Vertices of a level with n of them along an edge lie at (i + 1/2) / (n - 1) - 1 / (n - 1).
    """
    n = 5
    grid = HashGrid(GridShape(levels=1, features=2, log2_entries=8, coarsest=n, finest=n), seed=1)
    z, y, x = np.meshgrid(*[np.arange(n)] * 3, indexing="ij")
    place = (np.stack([x, y, z], -1).reshape(-1, 3) - 0.5) / (n - 1)
    linear = np.stack([place @ [1.0, 2.0, 4.0], place @ [-3.0, 0.5, 1.0] + 7], axis=1)
    size = dr.width(grid.parameters)
    assert size == 2 * n**3 or size == 2 * (n**3 + 1)
    table = np.zeros(size, dtype=np.float32)
    table[: linear.size] = linear.ravel()
    grid.update(from_numpy(mi.Float, table))
    where = points(50) * 0.8
    expected = np.stack([where @ [1.0, 2.0, 4.0], where @ [-3.0, 0.5, 1.0] + 7], axis=1)
    np.testing.assert_allclose(ask(grid, where), expected, rtol=1e-4, atol=1e-4)


def test_levels_beyond_the_table_share_its_entries():
    small = HashGrid(GridShape(3, 2, log2_entries=6, coarsest=4, finest=64), seed=1)
    assert dr.width(small.parameters) == 2 * 3 * 64
    again = HashGrid(GridShape(3, 2, log2_entries=6, coarsest=4, finest=64), seed=1)
    other = HashGrid(GridShape(3, 2, log2_entries=6, coarsest=4, finest=64), seed=2)
    assert (ask(small, points(9)) == ask(again, points(9))).all()
    assert (ask(small, points(9)) != ask(other, points(9))).any()


@needs_llvm
def test_a_network_without_hidden_layers_is_linear():
    network = Network(3, (), 2, seed=4)
    x = points(20)

    def answer(x: np.ndarray) -> np.ndarray:
        inputs = [from_numpy(mi.Float, column) for column in x.T]
        return np.array([y.numpy() for y in network(inputs)]).T

    zero = answer(np.zeros((1, 3), np.float32))
    matrix = np.vstack([answer(row[None]) - zero for row in np.eye(3, dtype=np.float32)])
    np.testing.assert_allclose(answer(x), x @ matrix + zero, atol=1e-5)
    assert np.abs(matrix).max() > 0.1
    before = answer(x)
    network.update(2 * network.parameters)
    np.testing.assert_allclose(answer(x), 2 * before, atol=1e-5)


@needs_llvm
@pytest.mark.parametrize("part", ["grid", "network"])
def test_gradients_agree_with_differences(part: str):
    grid = HashGrid(GridShape(2, 2, log2_entries=9, coarsest=3, finest=6), seed=1)
    network = Network(4, (8, 8), 3, seed=2)
    grid.update(
        from_numpy(mi.Float, np.random.default_rng(3).normal(0, 0.3, dr.width(grid.parameters)))
    )
    x = from_numpy(mi.Point3f, points(64))
    changed = grid if part == "grid" else network

    def loss(parameters: mi.Float) -> mi.Float:
        changed.update(parameters)
        return sum((dr.square(y - 1) for y in network(grid(x))), mi.Float(0))

    start = mi.Float(changed.parameters)
    dr.enable_grad(start)
    dr.backward(loss(start))
    gradient = dr.grad(start).numpy()

    def total(values: np.ndarray) -> float:
        return float(dr.sum(loss(from_numpy(mi.Float, values)))[0])

    check_differences(total, start, gradient)


def check_differences(
    loss: Callable[[np.ndarray], float], start: mi.Float, gradient: np.ndarray
) -> None:
    """Compare along directions in which the gradient is large, and against it."""
    values = dr.detach(start).numpy().astype(np.float64)
    rng = np.random.default_rng(5)
    for _ in range(3):
        direction = gradient * rng.uniform(0, 2, len(gradient))
        direction /= np.linalg.norm(direction)
        h = 1e-2
        ahead, behind = (loss((values + s * h * direction).astype(np.float32)) for s in (1, -1))
        assert (ahead - behind) / (2 * h) == pytest.approx(gradient @ direction, rel=0.02)


def test_a_cube_holds_the_box_and_its_margin():
    box = np.array([[-1.0, 0.0, 2.0], [3.0, 1.0, 4.0]])
    cube = Cube.around(box, margin=0.05)
    assert cube.edge == pytest.approx(4.4)
    corners = from_numpy(mi.Point3f, box)
    placed = cube.place(corners).numpy().T
    np.testing.assert_allclose(placed[:, 0], [0.2 / 4.4, 4.2 / 4.4], rtol=1e-5)
    np.testing.assert_allclose(placed.mean(axis=0), 0.5, rtol=1e-5)
    assert (placed > 0).all() and (placed < 1).all()
