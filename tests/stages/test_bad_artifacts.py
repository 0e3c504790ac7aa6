"""Files that are not what a stage needs: NaN in them, missing, damaged, or of something else."""

from __future__ import annotations

import json
import re
from functools import partial

import numpy as np
import OpenEXR
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from gpf.core.files import read_tensors, write_tensors
from gpf.core.images import read_exr, write_exr
from tests.stages.results import assert_refused

XML = "scenes/cornell_box/scene.xml"
VIEWS = "scenes/cornell_box/views.yaml"
ALL = ("scene", "reference", "photons", "train", "render", "metrics", "amortize")


# --- NaN --------------------------------------------------------------------------------------


def test_nan_radiance(finished):
    # A lamp that the cameras see, beside the one that works.
    lamp = (
        '<shape type="sphere"><point name="center" x="0" y="0" z="0.9"/>'
        '<float name="radius" value="0.1"/><ref id="white"/><emitter type="area">'
        '<rgb name="radiance" value="nan, 1, 1"/></emitter></shape></scene>'
    )
    finished.replace(XML, "</scene>", lamp)
    assert_refused(finished, "scene", r"scene\.xml: has NaN .* in radiance\.value of AreaLight")


def test_nan_reflectance(finished):
    finished.replace(XML, "0.105421, 0.37798, 0.076425", "nan, 0.37798, 0.076425")
    assert_refused(finished, "scene", r"scene\.xml: has NaN .* in reflectance\.value of green")


def test_nan_in_a_field(finished):
    change_tensors(finished.results / "field.safetensors", "irradiance", np.nan)
    assert_refused(finished, "render", r"NaN or infinite")


def test_nan_in_a_reference(finished):
    path = finished.results / "reference" / "above.exr"
    layers, record = read_exr(path)
    layers["radiance"][2, 5] = np.nan
    write_exr(path, layers, {k: v for k, v in record.items() if k != "schema_version"})
    assert_refused(finished, "metrics", r"above.*NaN or infinite")


# --- artifacts --------------------------------------------------------------------------------


def change_tensors(path, name: str, value: float) -> None:
    tensors, metadata = read_tensors(path, path.stem)
    tensors[name][:] = value
    write_tensors(path, path.stem, tensors, metadata)


def change_version(path) -> None:
    """Make an artifact one of schema version 99."""
    if path.suffix == ".exr":
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels.copy() for name, channel in file.channels().items()}
            record = json.loads(file.header()["gpf"])
        header = {"gpf": json.dumps({**record, "schema_version": 99})}
        OpenEXR.File(header, channels).write(str(path))
        return
    with safe_open(str(path), framework="numpy") as file:
        header = file.metadata()
    save_file(load_file(path), path, metadata={**header, "schema_version": "99"})


ARTIFACTS = [
    ("train", "targets.safetensors", "reference"),
    ("train", "photons.safetensors", "photons"),
    ("render", "field.safetensors", "train"),
    ("metrics", "reference/above.exr", "reference"),
    ("metrics", "second_reference/inside.exr", "reference"),
    ("metrics", "renders/gpf/floor.exr", "render"),
]


@pytest.mark.parametrize(("stage", "file", "maker"), ARTIFACTS)
def test_missing_artifact(finished, stage, file, maker):
    (finished.results / file).unlink()
    assert_refused(
        finished,
        stage,
        rf"results/cornell_box/{file}: is missing\. Run `gpf stage {maker} --scene "
        "cornell_box` first",
    )


@pytest.mark.parametrize(("stage", "file", "maker"), ARTIFACTS)
def test_truncated_artifact(finished, stage, file, maker):
    path = finished.results / file
    path.write_bytes(path.read_bytes()[:-50])
    assert_refused(
        finished,
        stage,
        rf"results/cornell_box/{file}: is truncated or \w.* Delete it and run `gpf stage {maker} "
        "--scene cornell_box` again",
    )


@pytest.mark.parametrize(("stage", "file", "maker"), ARTIFACTS)
def test_artifact_of_another_schema_version(finished, stage, file, maker):
    change_version(finished.results / file)
    assert_refused(
        finished,
        stage,
        rf"results/cornell_box/{file}: has schema version 99; this program reads \d+\. Delete it "
        rf"and run `gpf stage {maker} --scene cornell_box` again",
    )


@pytest.mark.parametrize("file", ["reference/left.exr", "reference/surfaces.safetensors"])
@pytest.mark.parametrize("damage", ["version", "half"])
def test_damaged_references_are_made_again_or_refused(finished, built, no_probe, file, damage):
    path = finished.results / file
    if damage == "version":
        change_version(path)
    else:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    before = finished.snapshot()
    outcome = finished.stage("reference")
    if outcome.code == 0:
        read = read_exr if path.suffix == ".exr" else partial(read_tensors, kind=path.stem)
        (ours, _), (whole, _) = read(path), read(built.results / file)
        assert ours.keys() == whole.keys()
        for name, values in whole.items():
            np.testing.assert_array_equal(ours[name], values, err_msg=name)
    else:
        assert outcome.code == 2 and "Traceback" not in outcome.text
        assert re.search(rf"{file}: (is truncated|has schema version 99).*Delete it", outcome.text)
        assert finished.snapshot() == before


@pytest.mark.parametrize(
    ("stage", "file", "maker"),
    [
        ("amortize", "costs/render.json", "render"),
        ("amortize", "metrics/gpf.json", "metrics"),
        ("reference", "costs/reference.json", "reference"),
    ],
)
def test_truncated_json(finished, stage, file, maker):
    path = finished.results / file
    path.write_text(path.read_text()[:40])
    assert_refused(
        finished,
        stage,
        rf"results/cornell_box/{file}: is not JSON .* Delete it and run `gpf stage {maker} --scene "
        "cornell_box` again",
    )


def test_truncated_checkpoint(finished):
    folder = finished.results / "checkpoints"
    folder.mkdir()
    (folder / "train.safetensors").write_bytes(b"half")
    assert_refused(
        finished,
        "train",
        r"checkpoints/train\.safetensors: is truncated or damaged .*Delete it and run",
    )


# --- stages out of order ----------------------------------------------------------------------


@pytest.mark.parametrize("stage", ["reference", "photons", "render", "metrics"])
def test_a_stage_before_the_scene_is_frozen(fresh, stage):
    outcome = fresh.stage(stage)
    assert outcome.code == 2
    assert "Run `gpf stage scene" in outcome.text, outcome.text
    assert not (fresh.folder / "results").exists() or fresh.snapshot() == {}


def test_images_of_another_size(finished):
    finished.edit("params.yaml", film__height=20)
    assert finished.stage("render").code == 0
    assert_refused(
        finished, "metrics", r"above.*20x16.*Run `gpf stage reference`|above.*gpf stage reference"
    )


def test_references_of_another_number_of_passes(finished):
    finished.edit("params.yaml", reference__passes=5)
    assert_refused(
        finished, "metrics", r"second_reference.*passes.*asks for 5.*gpf stage reference"
    )


@pytest.mark.parametrize(
    ("name", "maker"),
    [("targets", "reference"), ("photons", "photons")],
    ids=["targets", "photons"],
)
def test_a_file_of_another_scene(finished, name, maker):
    """Copied by mistake."""
    path = finished.results / f"{name}.safetensors"
    tensors, metadata = read_tensors(path, name)
    assert metadata["scene"] == "cornell_box"
    write_tensors(path, name, tensors, metadata | {"scene": "veach_ajar"})
    words = rf"{name}\.safetensors: belongs to the scene veach_ajar, not to cornell_box\. Delete it"
    assert_refused(finished, "train", rf"{words} and run `gpf stage {maker} --scene cornell_box`")
    write_tensors(path, name, tensors, {})  # as earlier versions wrote it
    assert finished.stage("train").code == 0
