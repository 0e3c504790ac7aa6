"""Fields' files whose content would end the process, or an error of Python, is told in words."""

from __future__ import annotations

import numpy as np
import pytest

from gpf.core.errors import FileError
from gpf.core.files import read_tensors, write_tensors
from gpf.field.field import GaussianPhotonField
from gpf.field.io import read_field, save_field, write_field
from gpf.field.settings import FieldSettings
from tests.plain_field import make_field, random_gaussians

COUNT = 20


def small_field() -> GaussianPhotonField:
    gaussians = random_gaussians(np.random.default_rng(0), COUNT)
    return make_field(gaussians, FieldSettings(search_radius=0.3))


@pytest.fixture(params=["float32", "compact"])
def file(tmp_path, request):
    """A field with levels and two groups."""
    path = tmp_path / "field.safetensors"
    save_field(small_field(), path)
    stored = read_field(path)
    light = stored.tensors["irradiance"]
    stored.tensors["lights"] = np.stack([0.25 * light, 0.75 * light])
    stored.tensors["levels"] = np.arange(COUNT, dtype=np.uint8) % 2
    stored.tensors["detail"] = np.array([[[0, 1, 0], [1, 0, 1]]], np.uint8)
    stored.grid.update(width=2.0, corner=[-1.0, 0.0, -0.5])
    stored.lights.update(names=["lamp", "sky"], members=[[1], [0, 2]])
    write_field(stored, path, request.param)
    read_field(path)
    return path


def changed(path, change):
    tensors, facts = read_tensors(path, "field")
    tensors = {name: value.copy() for name, value in tensors.items()}
    change(tensors, facts)
    write_tensors(path, "field", tensors, facts)
    return path


def take(name, rows):
    return lambda t, f: t.update({name: t[name][rows]})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t, f: t.pop("normals"), "has no tensor normals"),
        (lambda t, f: t.pop("levels"), "has no tensor levels"),
        (lambda t, f: t.pop("lights"), "has no tensor lights"),
        (take("quats", slice(1, None)), r"has quats of shape \(19, 4\), .*, not \(20, 4\)"),
        (take("levels", slice(1, None)), r"has levels of shape \(19,\)"),
        (take("lights", slice(1, None)), r"has lights of shape \(1, 20, 3\), .* not \(2, 20, 3\)"),
        (take("detail", slice(1, None)), "has no values in detail"),
        (lambda t, f: t.update(means=t["means"].astype("i8")), r"has means .*int64, not \(20, 3\)"),
        (lambda t, f: t["levels"].__setitem__(3, 2), "has levels that its table lacks"),
        (lambda t, f: t["quats"].__setitem__(3, 0), "has quats of length 0"),
        (lambda t, f: f.pop("bounds"), "has no bounds"),
        (lambda t, f: f.update(bounds=[[0, 0], [1, 1]]), r"wrong structure \(bounds\.0\.2: Field"),
        (lambda t, f: f.update(bounds=f["bounds"][::-1]), "has bounds whose corners are swapped"),
        (lambda t, f: f["settings"].update(search_radius=1e-9), "has a search radius too small"),
        (lambda t, f: f["settings"].update(k=0), r"wrong structure \(settings\.k: Input should be"),
        (lambda t, f: f["record"].update(fingerprint=3), r"wrong structure \(record\.fingerprint"),
        (lambda t, f: f["lights"].update(members=[[1], [0, 3]]), "groups that do not hold each"),
        (lambda t, f: f["grid"].update(width="x"), "wrong structure"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_field_is_told(file, change, words):
    with pytest.raises(FileError, match=rf"field\.safetensors: .*{words}"):
        read_field(changed(file, change))


def test_scales_beyond_single_precision_are_told(tmp_path):
    path = tmp_path / "field.safetensors"
    save_field(small_field(), path)
    with pytest.raises(FileError, match="has log_scales beyond the limits"):
        read_field(changed(path, lambda t, f: t["log_scales"].__setitem__((0, 0), 1e20)))


def test_a_field_without_gaussians_is_told(tmp_path):
    path = tmp_path / "field.safetensors"
    save_field(small_field(), path)
    with pytest.raises(FileError, match="has no values in means"):
        read_field(changed(path, lambda t, f: t.update({n: v[:0] for n, v in t.items()})))
