"""A field in media: what it scatters towards cameras, its levels, and its files."""

from __future__ import annotations

import dataclasses
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import FileError
from gpf.core.structs import Haze, from_numpy, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.io import VOLUME, load_field, read_field, save_field, write_field
from gpf.field.lights import FieldLights
from gpf.field.settings import FieldSettings
from gpf.field.volume import VolumeField
from gpf.scene.light_groups import LightGroups
from tests.foggy import fog_box, medium
from tests.plain_field import LOWER, UPPER, random_gaussians, to_device

COUNT = 300
BOUNDS = mi.ScalarPoint3f(LOWER), mi.ScalarPoint3f(UPPER)


def moments_of(colour: np.ndarray, direction, share: float, kind: int = 0) -> np.ndarray:
    """Those of light of one kind with a direction and a mean cosine, (N, 2, 3, 4)."""
    moments = np.zeros((len(colour), 2, 3, 4), np.float32)
    moments[:, kind, :, :3] = share * colour[:, :, None] * np.array(direction, np.float32)
    moments[:, kind, :, 3] = colour
    return moments


def make_volume(direction=(0.0, 0.0, 1.0), share=1.0, groups=False) -> VolumeField:
    """Light whose mean direction is the same everywhere; of two lamps, the second one's comes from
    the opposite side."""
    gaussians = to_device(random_gaussians(np.random.default_rng(2), COUNT))
    settings = FieldSettings(search_radius=0.5, normal_test=False)
    field = GaussianPhotonField(gaussians, settings, BOUNDS)
    colour = to_numpy(gaussians.irradiance)
    moments = moments_of(colour, direction, share)
    if not groups:
        return VolumeField(field, moments)
    field.lights = FieldLights(LightGroups(("a", "b"), ((0,), (1,))), np.stack([colour / 2] * 2))
    parts = np.stack([moments, moments_of(colour, -np.array(direction), share)]) / 2
    return VolumeField(field, parts.sum(axis=0), parts)


@pytest.fixture(scope="module")
def haze_towards():
    """Makes places in a medium with g = 0.5, seen from rays in one direction."""
    scene = mi.load_dict(fog_box(medium(1, g=0.5)))  # keeps the medium alive
    own = next(s.interior_medium() for s in scene.shapes() if s.interior_medium() is not None)
    yield lambda direction: places_in(own, direction)


def places_in(own: mi.Medium, direction, count=50) -> Haze:
    p = np.random.default_rng(5).uniform(LOWER, UPPER, (count, 3))
    found = Haze(
        p=from_numpy(mi.Point3f, p),
        d=from_numpy(mi.Vector3f, np.tile(direction, (count, 1))),
        medium=dr.full(mi.UInt32, 0, count),
        weight=dr.full(mi.Color3f, 1, count),
        depth=dr.zeros(mi.UInt32, count),
        valid=dr.full(mi.Bool, True, count),
    )
    found.medium = dr.select(found.valid, mi.MediumPtr(own), mi.MediumPtr(None))
    return found


def phase(cosine: float, g: float) -> float:
    """Henyey and Greenstein's function of the angle by which light turns."""
    return (1 - g * g) / (1 + g * g - 2 * g * cosine) ** 1.5 / (4 * math.pi)


@pytest.mark.parametrize("cosine", [1.0, 0.0, -1.0])
def test_a_beam_is_scattered_by_the_phase_function(haze_towards, cosine):
    """The light goes upwards; a ray that looks downwards sees what goes on straight."""
    sine = math.sqrt(1 - cosine**2)
    haze, volume = haze_towards((sine, 0, -cosine)), make_volume()
    fluence = to_numpy(volume.fluence.query(haze.p, mi.Normal3f(0, 0, 1), haze.valid)[0])
    expected = fluence.copy()
    expected *= phase(cosine, 0.5)
    np.testing.assert_allclose(to_numpy(volume.scattered(haze)), expected, rtol=1e-3)


def test_light_from_everywhere_is_scattered_evenly(haze_towards):
    haze, volume = haze_towards((0, 1, 0)), make_volume(share=0.0)
    fluence = to_numpy(volume.fluence.query(haze.p, mi.Normal3f(0, 0, 1), haze.valid)[0])
    np.testing.assert_allclose(to_numpy(volume.scattered(haze)), fluence / (4 * math.pi), rtol=1e-5)


def test_levels_change_light_and_direction(haze_towards):
    haze, volume = haze_towards((0, 0, -1)), make_volume(groups=True)
    both = to_numpy(volume.scattered(haze))
    volume.set_levels({"b": (0.0, 0.0, 0.0)})
    first = to_numpy(volume.scattered(haze))
    volume.set_levels({"a": (0.0, 0.0, 0.0)})
    second = to_numpy(volume.scattered(haze))
    np.testing.assert_allclose(first / second, phase(1, 0.5) / phase(-1, 0.5), rtol=0.05)
    volume.set_levels({})
    np.testing.assert_allclose(to_numpy(volume.scattered(haze)), both, rtol=1e-5)


def test_channels_have_directions_of_their_own(haze_towards):
    """Red light goes upwards, the rest comes from everywhere."""
    haze, volume = haze_towards((0, 0, -1)), make_volume()
    moments = volume.moments.copy()
    moments[:, :, 1:, :3] = 0
    volume = VolumeField(volume.fluence, moments)
    fluence = to_numpy(volume.fluence.query(haze.p, mi.Normal3f(0, 0, 1), haze.valid)[0])
    isotropic = 1 / (4 * math.pi)
    expected = fluence * [phase(1, 0.5), isotropic, isotropic]
    np.testing.assert_allclose(to_numpy(volume.scattered(haze)), expected, rtol=1e-3)


def test_light_that_is_scattered_is_a_wider_lobe(haze_towards):
    """A third of the light is a beam upwards; the rest is a lobe sideways with a mean cosine of .4,
    which is scattered into one of .5 · .4."""
    haze, volume = haze_towards((0, 0, -1)), make_volume()
    beam, rest = (volume.moments[:, 0, 0, 3:] * share for share in (1 / 3, 2 / 3))
    colour = np.ones(3, np.float32)
    moments = moments_of(beam * colour, (0, 0, 1), 1.0) + moments_of(
        rest * colour, (1, 0, 0), 0.4, kind=1
    )
    volume = VolumeField(volume.fluence, moments)
    fluence = to_numpy(volume.fluence.query(haze.p, mi.Normal3f(0, 0, 1), haze.valid)[0])
    expected = fluence * (phase(1, 0.5) / 3 + phase(0, 0.2) * 2 / 3)
    np.testing.assert_allclose(to_numpy(volume.scattered(haze)), expected, rtol=1e-3)


def test_arrays_of_another_volume(haze_towards):
    haze, one, other = haze_towards((0, 0, -1)), make_volume(), make_volume(share=0.3)
    found = one.with_arrays(other.arrays()).scattered(haze)
    np.testing.assert_array_equal(to_numpy(found), to_numpy(other.scattered(haze)))


def field_with_volume(groups: bool) -> GaussianPhotonField:
    gaussians = to_device(random_gaussians(np.random.default_rng(1), 40))
    field = GaussianPhotonField(gaussians, FieldSettings(search_radius=0.4), BOUNDS)
    field.volume = make_volume(groups=groups)
    field.volume.fluence.set_error(np.full(COUNT, 0.1, np.float32))
    return field


@pytest.mark.parametrize("groups", [False, True])
@pytest.mark.parametrize(("precision", "near"), [("float32", 1e-6), ("compact", 0.05)])
def test_files(haze_towards, tmp_path, groups, precision, near):
    field, path = field_with_volume(groups), tmp_path / "field.safetensors"
    save_field(field, path, precision)
    loaded, haze = load_field(path), haze_towards((0.6, 0, -0.8))
    assert loaded.volume.fluence.settings == field.volume.fluence.settings
    a, b = to_numpy(field.volume.scattered(haze)), to_numpy(loaded.volume.scattered(haze))
    np.testing.assert_allclose(b, a, rtol=near)
    np.testing.assert_allclose(to_numpy(loaded.volume.error(haze)), 0.1 * b, rtol=1e-2)
    if groups:
        loaded.volume.set_levels({"a": (0.0, 0.0, 0.0)})
    again = tmp_path / "again.safetensors"
    write_field(read_field(path), again, precision)
    assert again.read_bytes() == path.read_bytes()


@pytest.mark.parametrize("name", ["moments", "light_moments", "means"])
def test_a_file_without_a_tensor_of_the_volume(tmp_path, name):
    path = tmp_path / "field.safetensors"
    save_field(field_with_volume(groups=True), path)
    stored = read_field(path)
    assert stored.volume is not None
    inside = {key: value for key, value in stored.volume.tensors.items() if key != name}
    damaged = dataclasses.replace(stored, volume=dataclasses.replace(stored.volume, tensors=inside))
    write_field(damaged, path)
    with pytest.raises(FileError, match=name):
        read_field(path)


def test_the_names_of_the_volume_are_apart(tmp_path):
    path = tmp_path / "field.safetensors"
    save_field(field_with_volume(groups=False), path)
    from safetensors import safe_open

    with safe_open(str(path), framework="numpy") as file:
        names = set(file.keys())
    assert {VOLUME + "means", VOLUME + "moments", "means"} <= names
