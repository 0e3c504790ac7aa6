"""Texels: which of them lookups read, where they are, and what fills the gaps."""

from __future__ import annotations

import numpy as np
import pytest

from gpf.baking.texels import INSET, Texels, fill_page, find_texels, nearest_points

SIZE = (23, 17)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_nearest_points_are_nearest(rng):
    corners, q = rng.uniform(-1, 1, (40, 3, 2)), rng.uniform(-2, 2, (40, 2))
    weights, distance = nearest_points(corners, q)
    assert weights.min() >= 0 and weights.sum(axis=1) == pytest.approx(1)
    found = np.einsum("pk,pki->pi", weights, corners)
    np.testing.assert_allclose(np.linalg.norm(found - q, axis=1), distance, atol=1e-9)
    other = np.einsum("jk,pki->pji", rng.dirichlet([0.5] * 3, 4000), corners)
    sampled = np.linalg.norm(other - q[:, None], axis=2).min(axis=1)
    assert (distance <= sampled + 1e-9).all() and (sampled - distance).max() < 0.1


@pytest.mark.parametrize("at_once", [7, 1 << 19])
def test_all_texels_that_lookups_read_have_places(rng, monkeypatch, at_once):
    monkeypatch.setattr("gpf.baking.texels.AT_ONCE", at_once)
    # Thin ones, small ones, clockwise ones, one without area, and one at the border.
    corners = np.array(
        [
            [[1.5, 1.5], [20.2, 2.1], [20.3, 2.6]],
            [[3.1, 9.1], [3.3, 9.2], [3.2, 9.4]],
            [[8, 8], [8.5, 16.5], [14, 12]],
            [[2, 2], [3, 3], [4, 4]],
            [[22.5, 0], [23, 0], [23, 8]],
        ]
    )
    texels = find_texels(corners, SIZE)
    assert (np.diff(texels.index) > 0).all() and 3 not in texels.triangle
    for triangle in (0, 1, 2, 4):
        q = rng.dirichlet([1, 1, 1], 500) @ corners[triangle]
        low = np.floor(q - 0.5).astype(int)
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            x, y = np.clip(low + np.array([dx, dy]), 0, np.array(SIZE) - 1).T
            assert np.isin(y * SIZE[0] + x, texels.index).all()
    # Where centres are well inside, so are the points.
    place = np.einsum("pk,pki->pi", texels.weights, corners[texels.triangle])
    centre = np.stack([texels.index % SIZE[0], texels.index // SIZE[0]], axis=1) + 0.5
    offset = np.linalg.norm(place - centre, axis=1)
    assert (offset < 1e-5).sum() > 10 and offset.max() < 2**0.5 + 2 * INSET


def test_the_nearer_triangle_counts():
    corners = np.array([[[2, 2], [6, 2], [2, 12]], [[6.8, 2], [12, 2], [12, 12]]])
    texels = find_texels(corners, SIZE)
    row = texels.index // SIZE[0] == 2
    owner = dict(zip(texels.index[row] % SIZE[0], texels.triangle[row], strict=True))
    assert [owner[x] for x in (2, 5, 7, 11)] == [0, 0, 1, 1]


def test_gaps_are_filled():
    """Covered: the upper half; known: its left part."""
    width, height = SIZE
    rows, columns = (part.ravel() for part in np.indices((8, width)))
    index, known = rows * width + columns, columns < 10
    values = np.stack([1.0 + columns, np.ones(len(index))], axis=1)
    texels = Texels(index, np.zeros(len(index), int), np.zeros((len(index), 3)))
    page = fill_page(np.where(known[:, None], values, 99), known, texels, SIZE)
    assert page.shape == (height, width, 2)
    expected = np.where(np.arange(width) < 10, 1.0 + np.arange(width), 0)
    expected[10:12] = 10  # what is known spreads by two texels
    np.testing.assert_array_equal(page[:, :, 0], np.tile(expected, (height, 1)))


def test_where_nothing_is_known_all_is_black():
    index = np.arange(20)
    texels = Texels(index, np.zeros(20, int), np.zeros((20, 3)))
    page = fill_page(np.ones((20, 3)), np.zeros(20, bool), texels, SIZE)
    assert not page.any()
