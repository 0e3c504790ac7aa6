"""`gpf export`: splats and compact fields, by path or by scene; words where it cannot."""

from __future__ import annotations

import re

import numpy as np
import pytest

from gpf.core.files import read_tensors, write_tensors
from gpf.field.io import StoredField, read_field, write_field
from gpf.field.settings import FieldSettings
from tests.field.test_ply import columns, read_ply
from tests.plain_field import random_gaussians

FIELD = "results/cornell_box/field.safetensors"
COUNT = 3000


@pytest.fixture
def trained(fresh):
    """A project with a field, and the views that the stage `scene` puts beside it."""
    g = random_gaussians(np.random.default_rng(9), COUNT)
    names = ("means", "log_scales", "quats", "irradiance", "normals")
    tensors = {name: getattr(g, name).astype(np.float32) for name in names}
    record = {"scene": "0123", "steps": 20}
    field = StoredField(
        tensors, FieldSettings(search_radius=0.2, k=5), [[-1, 0, -0.5], [2, 2, 0.7]], record
    )
    write_field(field, fresh.folder / FIELD)
    views = (fresh.folder / "scenes/cornell_box/views.yaml").read_text(encoding="utf-8")
    views, found = re.subn(r"(?m)^exposure: .*$", "exposure: 0.35", views)
    assert found == 1
    (fresh.results / "views.yaml").write_text(views, encoding="utf-8")
    return fresh


def colours(project, name: str) -> np.ndarray:
    table = read_ply(project.folder / name)
    assert len(table) == COUNT
    return columns(table, "f_dc_0", "f_dc_1", "f_dc_2")


@pytest.mark.parametrize("field", ["cornell_box", FIELD])
def test_splats_with_the_scenes_exposure(trained, field):
    before = trained.snapshot()
    outcome = trained.gpf("export", field, "--ply", "splats.ply")
    assert outcome.code == 0, outcome.text
    assert "splats.ply: 0.2 MB, 3000 splats, exposure 0.35" in outcome.text
    assert trained.gpf("export", field, "--ply", "b.PLY", "--exposure", "0.35").code == 0
    assert trained.gpf("export", field, "--ply", "c.ply", "--exposure", "0.2").code == 0
    known = colours(trained, "splats.ply")
    np.testing.assert_array_equal(known, colours(trained, "b.PLY"))
    assert (colours(trained, "c.ply") < known).all()
    assert trained.snapshot() == before


def test_a_file_that_exists_is_not_replaced(trained):
    (trained.folder / "splats.ply").write_text("mine")
    outcome = trained.gpf("export", FIELD, "--ply", "splats.ply")
    assert outcome.code == 2 and "splats.ply: already exists. Add --overwrite" in outcome.text
    assert trained.gpf("export", FIELD, "--ply", "splats.ply", "--overwrite").code == 0
    assert (trained.folder / "splats.ply").read_bytes().startswith(b"ply")


def test_splats_of_a_field_without_views(trained):
    (trained.results / "views.yaml").unlink()
    outcome = trained.gpf("export", FIELD, "--ply", "splats.ply")
    assert outcome.code == 0, outcome.text
    shown = 0.5 + 0.28209479177387814 * colours(trained, "splats.ply")
    assert 0.4 < np.median(shown) < 0.55  # middle grey is 0.46 in sRGB


def test_a_compact_field(trained):
    outcome = trained.gpf("export", "cornell_box", "--compact", "out/small.safetensors")
    assert outcome.code == 0, outcome.text
    assert re.search(r"out/small\.safetensors: 0\.1 MB, 3\d% of results/cornell_box", outcome.text)
    small, whole = (read_field(trained.folder / f) for f in ("out/small.safetensors", FIELD))
    assert (small.settings, small.bounds, small.record) == (
        whole.settings,
        whole.bounds,
        whole.record,
    )
    np.testing.assert_allclose(small.tensors["irradiance"], whole.tensors["irradiance"], rtol=1e-3)
    # From there: the same bytes.
    outcome = trained.gpf(
        "export", "out/small.safetensors", "--compact", "again.safetensors", "--ply", "a.ply"
    )
    assert outcome.code == 0, outcome.text
    again = (trained.folder / "again.safetensors").read_bytes()
    assert again == (trained.folder / "out/small.safetensors").read_bytes()
    assert len(colours(trained, "a.ply")) == COUNT


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["cornell_box"],
            r"gpf export: has nothing to write\. Add --ply OUT\.ply or --compact OUT",
        ),
        (["gone.safetensors", "--ply", "a.ply"], r"gone\.safetensors: does not exist\. Check the"),
        (["a/b", "--ply", "a.ply"], r"error: a/b: does not exist\. Check the path"),
        (
            ["cornel_box", "--ply", "a.ply"],
            r"cornel_box: is neither a file nor a scene with results/cornel_box/field\.safetenso"
            r"rs\. Did you mean 'cornell_box'\? There are cornell_box",
        ),
        (
            ["results/cornell_box/photons.safetensors", "--ply", "a.ply"],
            r"photons\.safetensors: holds photons, not field\. Give the file of a field\.",
        ),
        (
            ["params.yaml", "--compact", "a.safetensors"],
            r"params\.yaml: is not a field\. Give a file whose name ends in \.safetensors\.",
        ),
        (
            ["cornell_box", "--ply", "a.obj"],
            r"--ply a\.obj: does not end in \.ply\. Give it a",
        ),
        (
            ["cornell_box", "--compact", "a"],
            r"--compact a: does not end in \.safetensors\. Give",
        ),
        (
            ["cornell_box", "--compact", FIELD],
            r"field\.safetensors: is the field itself\. Choose another name",
        ),
        (
            ["cornell_box", "--compact", "a.safetensors", "--exposure", "2"],
            r"--exposure 2\.0: is only for --ply",
        ),
        *(
            (
                ["cornell_box", "--ply", "a.ply", "--exposure", value],
                rf"--exposure {value}: is not an exposure\. Give a number above 0",
            )
            for value in ("0.0", "-1.0", "nan", "inf")
        ),
        (
            ["cornell_box", "--ply", "params.yaml/a.ply"],
            r"params\.yaml/a\.ply: could not be written \(.+\)\. Free some disk space or check the",
        ),
        (
            ["cornell_box", "--compact", "scenes.safetensors"],
            r"scenes\.safetensors: could not be written \(.+\)\. Free some disk space or check",
        ),
    ],
)
def test_what_cannot_be_exported(trained, arguments, words):
    power = {"power": np.ones((2, 3), np.float32)}
    write_tensors(trained.results / "photons.safetensors", "photons", power, {})
    (trained.folder / "scenes.safetensors").mkdir()
    before = trained.snapshot(), sorted(trained.folder.iterdir())
    outcome = trained.gpf("export", *arguments)
    assert outcome.code == 2, outcome.text
    assert re.search(words, outcome.text), outcome.text
    assert outcome.text.count("error:") == 1 and "Traceback" not in outcome.text
    assert (trained.snapshot(), sorted(trained.folder.iterdir())) == before


def test_a_field_that_is_not_finite(trained):
    path = trained.folder / FIELD
    tensors, metadata = read_tensors(path, "field")
    tensors["quats"][5, 2] = np.nan
    write_tensors(path, "field", tensors, metadata)
    outcome = trained.gpf("export", "cornell_box", "--ply", "a.ply")
    assert outcome.code == 2
    assert "has NaN or infinite values in quats. " in outcome.text
    assert not (trained.folder / "a.ply").exists()


def test_nothing_trained_yet(fresh):
    outcome = fresh.gpf("export", "cornell_box", "--ply", "a.ply")
    assert outcome.code == 2
    assert "Run `gpf stage train --scene cornell_box`" in outcome.text
