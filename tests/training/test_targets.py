"""Targets: which points training gets, and what it should learn there."""

import drjit as dr
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.training.targets import SURFACES, Targets, source_numbers
from stages.references.targets import join, save, targets_of_surfaces, targets_of_view

HEIGHT, WIDTH = 6, 8


def make_layers(seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    layers = {
        name: rng.uniform(0.1, 2, (HEIGHT, WIDTH, 3)).astype(np.float32)
        for name in ("position", "normal", "irradiance", "direct", "reflectance")
    }
    layers["valid"] = np.ones((HEIGHT, WIDTH), np.float32)
    layers["valid"][1, 6] = layers["valid"][4, 0] = 0
    return layers


def make_targets() -> Targets:
    """46 points of view 0, 46 of view 1 and 5 of the surfaces."""
    rng = np.random.default_rng(9)
    surfaces = {
        name: rng.uniform(0.1, 2, (5, 3)).astype(np.float32)
        for name in ("position", "normal", "irradiance", "direct")
    }
    views = [targets_of_view(make_layers(k), k) for k in range(2)]
    return join([*views, targets_of_surfaces(surfaces)])


def test_a_view_gives_its_valid_pixels_in_image_order():
    layers = make_layers()
    targets = targets_of_view(layers, 3)
    rows = [
        layers["position"][y, x]
        for y in range(HEIGHT)
        for x in range(WIDTH)
        if (y, x) not in ((1, 6), (4, 0))
    ]
    np.testing.assert_array_equal(targets.position, rows)
    assert targets.source.tolist() == [3] * 46
    assert targets.irradiance.shape == targets.normal.shape == targets.reflectance.shape == (46, 3)


def test_sources_are_told_apart():
    targets = make_targets()
    numbers = source_numbers(["left", "right", SURFACES])
    assert numbers.tolist() == [0, 1, -1] and numbers.dtype == targets.source.dtype
    assert [np.count_nonzero(targets.source == s) for s in numbers] == [46, 46, 5]
    assert len(targets.select("views").position) == 92
    surface = targets.select("surface")
    np.testing.assert_array_equal(surface.position, targets.position[92:])
    np.testing.assert_array_equal(surface.reflectance, np.ones((5, 3)))
    assert targets.select("both") is targets


def test_targets_come_back_from_their_file(tmp_path):
    targets = make_targets()
    save(targets, tmp_path / "targets.safetensors")
    again = Targets.load(tmp_path / "targets.safetensors")
    for name, value in vars(targets).items():
        np.testing.assert_array_equal(getattr(again, name), value)
        assert getattr(again, name).dtype == value.dtype


def test_points_for_irradiance_are_the_targets_themselves():
    targets = make_targets()
    points = targets.supervised_points("both", "irradiance")
    np.testing.assert_array_equal(np.array(points.p).T, targets.position)
    np.testing.assert_array_equal(np.array(points.n).T, targets.normal)
    np.testing.assert_array_equal(np.array(points.target).T, targets.irradiance)


def test_points_for_radiance_are_those_of_views_times_their_reflectance():
    targets = make_targets()
    points = targets.supervised_points("both", "radiance")
    assert dr.width(points.p) == 92
    expected = targets.irradiance[:92] * targets.reflectance[:92] / np.pi
    np.testing.assert_allclose(np.array(points.target).T, expected, rtol=1e-6)


@pytest.mark.parametrize(("points", "stores"), [("surface", "irradiance"), ("views", "irradiance")])
def test_a_choice_that_leaves_nothing_is_said_in_words(points, stores):
    targets = make_targets().select("views" if points == "surface" else "surface")
    count = len(targets.position)
    with pytest.raises(
        UserError,
        match=rf"train\.points: '{points}' selects none of {count} targets\. Choose another, or "
        r"set reference\.surface_points above 0",
    ):
        targets.supervised_points(points, stores)
