"""What a user can get wrong: words that say where, what and what to do, exit code 2, no traceback,
and whatever was there before is there after."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from gpf.images import read_exr, write_exr

XML = "scenes/cornell_box/scene.xml"
VIEWS = "scenes/cornell_box/views.yaml"
ALL = ("scene", "reference", "photons", "train", "render", "metrics", "amortize")


def assert_refused(project, stage: str, words: str, scene: str = "cornell_box") -> None:
    """The stage ends with the words and code 2, and nothing below results/ is touched."""
    before = project.snapshot()
    outcome = project.stage(stage, scene)
    assert re.search(words, outcome.text), outcome.text
    assert outcome.code == 2
    assert outcome.text.count("error:") == 1
    assert "Traceback" not in outcome.text
    assert project.snapshot() == before


# --- params.yaml ------------------------------------------------------------------------------


@pytest.mark.parametrize("stage", ALL)
def test_unknown_params_key(finished, stage):
    finished.edit("params.yaml", train__stepps=10)
    assert_refused(
        finished,
        stage,
        r"error: params\.yaml: train\.stepps: is an unknown key\. Did you mean 'steps'\? Known",
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"field__k": -1},
            r"params\.yaml: field\.k: is -1\. Input should be greater than or equal",
        ),
        ({"train__rates__means": "fast"}, r"train\.rates\.means: is 'fast'\. Input should be a"),
        ({"reference__initial_radius": 0}, r"initial_radius: is 0\. .* greater than 0, or auto"),
        ({"runtime__variant": "scalar_rgb"}, r"runtime\.variant: is 'scalar_rgb'\. Input should"),
        ({"amortize__views": 1}, r"params\.yaml: amortize\.views: is 1\. Input should be greater"),
    ],
)
def test_value_out_of_range(finished, change, words):
    finished.edit("params.yaml", **change)
    assert_refused(finished, "train", words)


def test_params_that_are_not_yaml(finished):
    finished.replace("params.yaml", "film:", "film")
    assert_refused(finished, "scene", r"params\.yaml: is not YAML: .*Correct that line")


def test_another_folder(tmp_path, fresh):
    (fresh.folder / "params.yaml").unlink()
    assert_refused(
        fresh, "scene", r"params\.yaml: cannot be read\. Run `gpf` in the project's folder"
    )


# --- the command line -------------------------------------------------------------------------


def test_unknown_scene(finished):
    assert_refused(
        finished,
        "scene",
        r"error: scene 'cornel_box': does not exist\. Did you mean 'cornell_box'\? The scenes are",
        scene="cornel_box",
    )


@pytest.mark.parametrize(
    ("stage", "passes", "words"),
    [
        (
            "reference",
            "250",
            r"error: --passes 250: is no range of passes\. Write it as FIRST:LAST",
        ),
        ("reference", "a:b", r"--passes a:b: is no range of passes"),
        ("reference", "3:3", r"--passes 3:3: is not within the 4 passes of params\.yaml"),
        ("reference", "0:400", r"--passes 0:400: is not within the 4 passes"),
        ("train", "0:2", r"error: --passes 0:2: is not for train\. Leave it out"),
    ],
)
def test_a_range_that_is_none(finished, stage, passes, words):
    before = finished.snapshot()
    outcome = finished.gpf("stage", stage, "--scene", "cornell_box", "--passes", passes)
    assert outcome.code == 2 and re.search(words, outcome.text), outcome.text
    assert finished.snapshot() == before


def test_unknown_stage(fresh):
    outcome = fresh.stage("trian")
    assert outcome.code == 2
    assert "trian" in outcome.text and "'train'" in outcome.text
    assert "Traceback" not in outcome.text


def test_unknown_profile(fresh):
    before = (fresh.folder / "params.yaml").read_bytes()
    outcome = fresh.gpf("profile", "smok")
    assert outcome.code == 2
    assert re.search(r"profile 'smok': does not exist\. Did you mean 'smoke'", outcome.text)
    assert (fresh.folder / "params.yaml").read_bytes() == before


def test_in_a_process_of_its_own(finished, environment):
    finished.edit("params.yaml", field__k=0)
    before = finished.snapshot()
    done = subprocess.run(
        [sys.executable, "-m", "stages.cli", "stage", "train", "--scene", "cornell_box"],
        cwd=finished.folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("error: params.yaml: field.k: is 0. Input should be greater than")
    assert done.stdout == "" and len(done.stderr.splitlines()) == 1
    assert finished.snapshot() == before


# --- scenes -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        (
            XML,
            "</scene>",
            "</scne>",
            r"scenes/cornell_box/scene\.xml: does not parse: .*Correct the",
        ),
        (
            XML,
            'type="cube" id="small',
            'type="cone" id="small',
            r"scene\.xml: does not load: .*cone",
        ),
        (
            XML,
            'type="cube" id="small-box">',
            'type="ply" id="small-box"><string name="filename" value="meshes/box.ply"/>',
            r"scene\.xml:\d+: refers to .*meshes/box\.ply, which does not exist\. Put it there",
        ),
        (
            XML,
            '<emitter type="area">',
            '<emitter type="area" id="$none">',
            r"scene\.xml: does not load: ",
        ),
        (
            VIEWS,
            "  novel:",
            "  novels:",
            r"views\.novels: is an unknown key\. Did you mean 'novel'",
        ),
        (
            VIEWS,
            "exposure: 1.8",
            "exposure: -1",
            r"exposure: is -1\. Input should be greater than 0",
        ),
        (VIEWS, "exposure: 1.8", "exposure 1.8", r"views\.yaml: is not YAML"),
    ],
)
def test_scene_that_does_not_parse(finished, file, old, new, words):
    finished.replace(file, old, new)
    assert_refused(finished, "scene", words)


def remove(text: str, start: str, end: str) -> str:
    """The text without the first piece from ``start`` to ``end``."""
    before, _, rest = text.partition(start)
    assert rest and end in rest
    return before + rest.partition(end)[2]


def test_scene_without_emitters(finished):
    path = finished.folder / XML
    path.write_text(remove(path.read_text(), "<emitter", "</emitter>"))
    assert_refused(
        finished, "scene", r"scene\.xml: has no emitters, so there are no photons\. Add a light"
    )


def test_scene_without_diffuse_surfaces(finished):
    path = finished.folder / XML
    text = re.sub(r'<bsdf type="diffuse" (id="\w+")>.*?</bsdf>', r'<bsdf type="conductor" \1/>',
                  path.read_text(), flags=re.DOTALL)  # fmt: skip
    assert text.count("conductor") == 3
    path.write_text(text)
    assert_refused(
        finished,
        "scene",
        r"scene\.xml: has no diffuse surface, so no photon can be stored\. Give at least one shape",
    )


def test_views_without_training_views(finished):
    path = finished.folder / VIEWS
    path.write_text(remove(path.read_text(), "  train:\n", "fov: 48}\n    - {name: right,").replace(
        " origin: [0.85, 0.55, 2.2], target: [-0.35, -0.3, -0.3], fov: 48}\n", ""))  # fmt: skip
    assert_refused(
        finished,
        "scene",
        r"scenes/cornell_box/views\.yaml: has no training views\. List at least one view under "
        r"views: train",
    )


def test_training_views_that_see_nothing_diffuse(finished):
    text = (finished.folder / VIEWS).read_text()
    views = re.findall(r"- {name: (?:front|left|right), .*}", text)
    assert len(views) == 3
    for view in views:
        name = view.split()[2]
        text = text.replace(
            view, f"- {{name: {name} origin: [0, 0, 9], target: [0, 0, 19], fov: 40}}"
        )
    (finished.folder / VIEWS).write_text(text)
    finished.edit("params.yaml", reference__surface_points=0, reference__initial_radius=0.1)
    assert finished.stage("scene").code == 0
    outcome = finished.stage("reference")
    assert outcome.code == 2
    assert "training views: see no diffuse surface. Point them at one" in outcome.text
    finished.edit("params.yaml", outlook__use=False)
    assert finished.stage("reference").code == 0
    assert_refused(
        finished,
        "train",
        r"params\.yaml: train\.points: 'both' selects none of 0 targets\. Choose another, or set "
        r"reference\.surface_points above 0",
    )


# --- NaN --------------------------------------------------------------------------------------

LOOK = r"Look for a zero-area emitter, a mesh with broken normals or a material"


def test_nan_radiance(finished):
    # A lamp that the cameras see, beside the one that works.
    lamp = (
        '<shape type="sphere"><point name="center" x="0" y="0" z="0.9"/>'
        '<float name="radius" value="0.1"/><ref id="white"/><emitter type="area">'
        '<rgb name="radiance" value="nan, 1, 1"/></emitter></shape></scene>'
    )
    finished.replace(XML, "</scene>", lamp)
    assert finished.stage("scene").code == 0
    assert_refused(
        finished,
        "reference",
        rf"cornell_box, view front, radiance: \d+ of 320 pixels are NaN or infinite, the first at "
        rf"x=\d+, y=\d+\. {LOOK}",
    )


def test_nan_reflectance(finished):
    finished.replace(XML, "0.105421, 0.37798, 0.076425", "nan, 0.37798, 0.076425")
    assert finished.stage("scene").code == 0
    assert_refused(finished, "reference", rf"cornell_box, .*NaN or infinite, .*{LOOK}")


def test_nan_in_a_field(finished):
    change_tensors(finished.results / "field.safetensors", "irradiance", np.nan)
    assert_refused(finished, "render", r"NaN or infinite")


def test_nan_in_a_reference(finished):
    path = finished.results / "reference" / "above.exr"
    layers, record = read_exr(path, "reference")
    layers["radiance"][2, 5] = np.nan
    write_exr(path, layers, {k: v for k, v in record.items() if k != "schema_version"})
    assert_refused(finished, "metrics", r"above.*NaN or infinite")


# --- artifacts --------------------------------------------------------------------------------


def change_tensors(path, name: str, value: float) -> None:
    with safe_open(str(path), framework="numpy") as file:
        header = file.metadata()
    tensors = load_file(path)
    tensors[name][:] = value
    save_file(tensors, path, metadata=header)


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
    ("metrics", "ceiling/inside.exr", "reference"),
    ("metrics", "renders/gpf/floor.exr", "render"),
]


@pytest.mark.parametrize(("stage", "file", "maker"), ARTIFACTS)
def test_missing_artifact(finished, stage, file, maker):
    (finished.results / file).unlink()
    assert_refused(
        finished, stage, rf"results/cornell_box/{file}: is missing\. Run `gpf stage {maker}` first"
    )


@pytest.mark.parametrize(("stage", "file", "maker"), ARTIFACTS)
def test_truncated_artifact(finished, stage, file, maker):
    path = finished.results / file
    path.write_bytes(path.read_bytes()[:-50])
    assert_refused(
        finished,
        stage,
        rf"results/cornell_box/{file}: is truncated or \w.* Delete it and run `gpf stage {maker}` "
        "again",
    )


@pytest.mark.parametrize(("stage", "file", "maker"), ARTIFACTS)
def test_artifact_of_another_schema_version(finished, stage, file, maker):
    change_version(finished.results / file)
    assert_refused(
        finished,
        stage,
        rf"results/cornell_box/{file}: has schema version 99; this program reads \d+\. Delete it "
        rf"and run `gpf stage {maker}` again",
    )


@pytest.mark.parametrize("file", ["reference/left.exr", "reference/surfaces.safetensors"])
@pytest.mark.parametrize("damage", ["version", "half"])
def test_damaged_references_are_made_again_or_refused(finished, built, file, damage):
    path = finished.results / file
    if damage == "version":
        change_version(path)
    else:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    before = finished.snapshot()
    outcome = finished.stage("reference")
    if outcome.code == 0:
        whole = built.snapshot()[f"results/cornell_box/{file}"]
        assert path.stat().st_size == (built.results / file).stat().st_size, whole
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
        rf"results/cornell_box/{file}: is not JSON .* Delete it and run `gpf stage {maker}` again",
    )


def test_truncated_checkpoint(finished):
    folder = finished.results / "checkpoints"
    folder.mkdir()
    (folder / "train-all.safetensors").write_bytes(b"half")
    assert_refused(
        finished,
        "train",
        r"checkpoints/train-all\.safetensors: is truncated or damaged .*Delete it and run",
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
    assert_refused(finished, "metrics", r"ceiling.*(passes|sppm_5).*gpf stage reference")
