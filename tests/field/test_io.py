"""Field files: exact in float32, small and near in compact, and words where they are broken."""

from dataclasses import replace

import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.core.files import read_tensors, write_tensors
from gpf.field.io import StoredField, load_field, read_field, save_field, write_field
from gpf.field.lights import FieldLights
from gpf.field.settings import FieldSettings
from gpf.scene.light_groups import LightGroups
from tests.plain_field import (
    PlainGaussians,
    ask,
    bounds,
    make_field,
    random_gaussians,
    random_normals,
    single,
)

RADIUS = 0.15
NAMES = ("means", "log_scales", "quats", "irradiance", "normals")


def surface_gaussians(count: int) -> PlainGaussians:
    """A 3 by 2 floor, dark on the left, a million times as bright on the right.

    Scales are from a tenth of to twice the radius, in every proportion.
    """
    rng = np.random.default_rng(5)
    means = np.column_stack([rng.uniform(0, 3, count), rng.uniform(0, 2, count), np.zeros(count)])
    brightness = 10 ** (2 * means[:, :1] - 3)
    return PlainGaussians(
        means=single(means + rng.normal(0, 0.02 * RADIUS, means.shape)),
        log_scales=single(np.log(RADIUS) + rng.uniform(np.log(0.1), np.log(2), (count, 3))),
        quats=single(rng.normal(size=(count, 4))),
        irradiance=single(brightness * rng.uniform(0.5, 1, (count, 3))),
        normals=np.tile([0.0, 0.0, 1.0], (count, 1)),
    )


def stored(g: PlainGaussians, radius: float = RADIUS, **changes: np.ndarray) -> StoredField:
    tensors = {name: getattr(g, name).astype(np.float32) for name in NAMES} | changes
    return StoredField(
        tensors, FieldSettings(search_radius=radius), [[-1, 0, -0.5], [2, 2, 0.7]], {"scene": "a"}
    )


def compacted(field: StoredField, folder) -> dict[str, np.ndarray]:
    """The tensors after a round trip; a second one changes neither them nor a byte of the file."""
    first, second = folder / "first.safetensors", folder / "second.safetensors"
    write_field(field, first, "compact")
    again = read_field(first)
    write_field(again, second, "compact")
    assert first.read_bytes() == second.read_bytes()
    assert (again.settings, again.bounds, again.record) == (
        field.settings,
        field.bounds,
        field.record,
    )
    assert {name: value.dtype for name, value in again.tensors.items()} == dict.fromkeys(
        NAMES, np.dtype("float32")
    )
    return again.tensors


# --- float32 ----------------------------------------------------------------------------------


def test_a_saved_field_comes_back_bit_for_bit(tmp_path):
    rng = np.random.default_rng(11)
    g = random_gaussians(rng, 37)
    settings = FieldSettings(
        search_radius=0.123,
        k=4,
        neighbours="knn",
        blend="sum",
        stores="radiance",
        normal_test=False,
    )
    field = make_field(g, settings, record={"scene": "böx", "params": {"steps": [1, 2.5]}})
    save_field(field, tmp_path / "field.safetensors")
    loaded = load_field(tmp_path / "field.safetensors")
    assert loaded.settings == settings
    assert loaded.record == {"scene": "böx", "params": {"steps": [1, 2.5]}}
    for corner, other in zip(loaded.bounds, bounds(), strict=True):
        assert [float(v) for v in corner] == [float(v) for v in other]
    for name in NAMES:
        before, after = (getattr(f.gaussians, name) for f in (field, loaded))
        assert np.array(before).tobytes() == np.array(after).tobytes(), name
        np.testing.assert_array_equal(np.array(after).T, getattr(g, name).astype(np.float32))
    x, n = rng.uniform(-1, 2, (20, 3)), random_normals(rng, 20)
    np.testing.assert_array_equal(ask(field, x, n)[0], ask(loaded, x, n)[0])


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 0), ("compact", 5e-4)])
def test_the_light_of_groups_comes_back(tmp_path, precision, tolerance):
    rng = np.random.default_rng(12)
    parts = rng.uniform(0.1, 2, (2, 37, 3)).astype(np.float32)
    groups = LightGroups(("sun", "lamps"), ((1,), (0, 2)))
    g = replace(random_gaussians(rng, 37), irradiance=single(parts.sum(axis=0)))
    field = make_field(g, FieldSettings(search_radius=0.3), lights=FieldLights(groups, parts))
    save_field(field, tmp_path / "field.safetensors", precision)
    again = load_field(tmp_path / "field.safetensors")
    assert again.lights.groups == groups
    # The order of a compact file is one in space.
    order, found = (np.argsort(x.sum(axis=(0, 2))) for x in (parts, again.lights.irradiance))
    np.testing.assert_allclose(
        again.lights.irradiance[:, found], parts[:, order], rtol=tolerance, atol=0
    )


def test_a_file_from_before_there_was_a_compact_precision(tmp_path):
    path = tmp_path / "field.safetensors"
    write_field(stored(surface_gaussians(5)), path)
    tensors, metadata = read_tensors(path, "field")
    assert metadata.pop("precision") == "float32" and metadata.pop("encoding") == {}
    write_tensors(path, "field", tensors, metadata)
    for name, value in read_field(path).tensors.items():
        np.testing.assert_array_equal(value, tensors[name])


# --- compact ----------------------------------------------------------------------------------


def test_a_compact_field_is_small_and_answers_alike(tmp_path):
    """Dark places as well as bright ones: the error is relative."""
    g = surface_gaussians(8000)
    field = make_field(
        g, FieldSettings(search_radius=RADIUS), record={"scene": "a", "params": {"k": 3}}
    )
    path = tmp_path / "field.safetensors"
    save_field(field, path, "compact")
    assert 22 * 8000 < path.stat().st_size < 22 * 8000 + 2000  # 2.2 MB for 100,000
    _, metadata = read_tensors(path, "field")
    assert metadata["precision"] == "compact"
    assert metadata["record"] == {"scene": "a", "params": {"k": 3}}

    rng = np.random.default_rng(6)
    x = np.column_stack([rng.uniform(0, 3, 4000), rng.uniform(0, 2, 4000), np.zeros(4000)])
    n = np.tile([0.0, 0.0, 1.0], (4000, 1))
    exact, near = ask(field, x, n)[0], ask(load_field(path), x, n)[0]
    assert exact.max() / exact.min() > 1e5
    error = np.abs(near / exact - 1)
    for third in range(3):
        here = (x[:, 0] // 1).astype(int) == third
        # A field of 45 dB, whose own error is 0.0056 of white, would lose 0.1 dB by 0.0008.
        assert np.sqrt(np.mean(error[here] ** 2)) < 5e-4, third
    compacted(read_field(path), tmp_path)


def test_each_tensor_is_as_near_as_the_format_says(tmp_path):
    g = random_gaussians(np.random.default_rng(7), 500)
    before = stored(g).tensors
    after = compacted(stored(g), tmp_path)
    step = np.ptp(before["means"], axis=0) / 65535
    assert (np.abs(after["means"] - before["means"]) <= 0.51 * step).all()
    step = np.ptp(before["log_scales"], axis=0) / 255
    assert (np.abs(after["log_scales"] - before["log_scales"]) <= 0.51 * step).all()
    np.testing.assert_allclose(after["irradiance"], before["irradiance"], rtol=2**-11)
    for name, most in (("quats", 0.5), ("normals", 0.5)):
        unit = before[name] / np.linalg.norm(before[name], axis=1, keepdims=True)
        np.testing.assert_allclose(np.linalg.norm(after[name], axis=1), 1, rtol=1e-6)
        cosine = np.clip((unit * after[name]).sum(axis=1), -1, 1)
        assert np.degrees(np.arccos(cosine)).max() < most, name


def test_eight_orders_of_brightness_and_light_that_training_made_negative(tmp_path):
    bright = 10.0 ** np.arange(3, -7, -1)
    values = np.outer([1, 0, -1], bright).reshape(-1, 3).astype(np.float32)
    g = surface_gaussians(len(values))
    after = compacted(stored(g, irradiance=values), tmp_path)["irradiance"]
    np.testing.assert_array_equal(np.sign(after), np.sign(values))
    most = np.abs(values) > 1e-5
    np.testing.assert_allclose(after[most], values[most], rtol=2**-11)
    np.testing.assert_allclose(after, values, rtol=0.01)


@pytest.mark.parametrize("scale", [1e-30, 3.1e7])
@pytest.mark.parametrize("greatest", [1.0, 0.99999, 0.50001, 0.5])
def test_any_unit_of_brightness(tmp_path, greatest, scale):
    """Also where rounding takes the greatest to the next power of two."""
    values = (scale * np.array([[greatest, 0.3, 0.001], [0, 0.25, 1e-4]])).astype(np.float32)
    after = compacted(stored(surface_gaussians(2), irradiance=values), tmp_path)["irradiance"]
    np.testing.assert_allclose(after, values, rtol=2**-11)


@pytest.mark.parametrize("count", [1, 7])
def test_one_gaussian_and_equal_ones_are_exact(tmp_path, count):
    one = surface_gaussians(1)
    g = PlainGaussians(*(np.repeat(getattr(one, name), count, axis=0) for name in NAMES))
    after = compacted(stored(g), tmp_path)
    for name in ("means", "log_scales"):
        np.testing.assert_array_equal(after[name], getattr(g, name).astype(np.float32))
    np.testing.assert_array_equal(after["normals"], g.normals)
    field = make_field(g, FieldSettings(search_radius=RADIUS))
    save_field(field, tmp_path / "field.safetensors", "compact")
    point, up = g.means[:1] + np.array([0.02, 0, 0]), [[0, 0, 1]]
    value = ask(load_field(tmp_path / "field.safetensors"), point, up)[0]
    np.testing.assert_allclose(value, ask(field, point, up)[0], rtol=1e-3)


def test_black_and_far_from_the_origin(tmp_path):
    """Where single precision has fewer steps than the file: still the same bytes again."""
    g = surface_gaussians(300)
    means = (g.means + np.array([4096, -70000, 1e6])).astype(np.float32)
    after = compacted(stored(g, means=means, irradiance=np.zeros((300, 3), "f4")), tmp_path)
    assert (after["irradiance"] == 0).all()
    np.testing.assert_allclose(after["means"][:, 1:], means[:, 1:], atol=1e-2)
    np.testing.assert_array_equal(after["means"][:, 2], means[:, 2])


def test_a_collapsed_scale_does_not_cost_the_others_their_digits(tmp_path):
    g = surface_gaussians(400)
    log_scales = g.log_scales.astype(np.float32)
    log_scales[3], log_scales[8] = -80, 30
    after = compacted(stored(g, log_scales=log_scales), tmp_path)["log_scales"]
    np.testing.assert_allclose(
        np.delete(after, [3, 8], 0), np.delete(log_scales, [3, 8], 0), atol=0.02
    )
    assert (after[3] < np.log(RADIUS) - 5).all() and (after[8] > np.log(RADIUS) + 3).all()


# --- broken -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["means", "irradiance"])
@pytest.mark.parametrize("precision", ["float32", "compact"])
def test_nan_is_not_written(tmp_path, name, precision):
    field = stored(surface_gaussians(4))
    field.tensors[name][2, 1] = np.nan
    with pytest.raises(UserError, match=rf"field\.safetensors: was not written, because {name} "):
        write_field(field, tmp_path / "field.safetensors", precision)
    assert list(tmp_path.iterdir()) == []


def test_infinite_values_in_a_file_are_said_in_words(tmp_path):
    path = tmp_path / "field.safetensors"
    write_field(stored(surface_gaussians(4)), path, "compact")
    tensors, metadata = read_tensors(path, "field")
    tensors["irradiance"][3, 0] = np.inf
    write_tensors(path, "field", tensors, metadata)
    with pytest.raises(UserError, match="has NaN or infinite values in irradiance"):
        load_field(path)


def test_a_missing_field_is_said_in_words(tmp_path):
    with pytest.raises(UserError, match=r"field\.safetensors: is missing\. Check the path"):
        load_field(tmp_path / "field.safetensors")


def test_another_kind_of_file_is_said_in_words(tmp_path):
    path = tmp_path / "photons.safetensors"
    write_tensors(path, "photons", {"power": np.ones((2, 3), np.float32)}, {})
    with pytest.raises(UserError, match="holds photons, not field"):
        load_field(path)


def test_an_unknown_precision_is_said_in_words(tmp_path):
    path = tmp_path / "field.safetensors"
    write_field(stored(surface_gaussians(4)), path)
    tensors, metadata = read_tensors(path, "field")
    write_tensors(path, "field", tensors, {**metadata, "precision": "tiny"})
    with pytest.raises(
        UserError, match=r"has the precision tiny; this program reads float32 and compact\. Delete"
    ):
        load_field(path)


def test_settings_travel_in_both_precisions(tmp_path):
    settings = FieldSettings(
        search_radius=0.2, k=5, neighbours="radius", blend="sum", normal_test=False
    )
    for precision in ("float32", "compact"):
        field = replace(stored(surface_gaussians(3)), settings=settings)
        write_field(field, tmp_path / "field.safetensors", precision)
        assert load_field(tmp_path / "field.safetensors").settings == settings


@pytest.mark.parametrize(("precision", "within"), [("float32", 0), ("compact", 1e-3)])
def test_the_error_travels_in_both_precisions(tmp_path, precision, within):
    rng = np.random.default_rng(4)
    field = make_field(random_gaussians(rng, 30), FieldSettings(search_radius=0.2))
    path = tmp_path / "field.safetensors"
    save_field(field, path, precision)
    assert load_field(path).error is None
    field.set_error(rng.uniform(0, 0.2, 30).astype(np.float32))
    save_field(field, path, precision)
    np.testing.assert_allclose(load_field(path).error, field.error, rtol=within)
