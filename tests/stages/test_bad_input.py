"""What a user can get wrong: words that say where, what and what to do, exit code 2, no traceback,
and whatever was there before is there after."""

from __future__ import annotations

import gc
import re
import subprocess
import sys

import pytest

from tests.stages.results import assert_refused

XML = "scenes/cornell_box/scene.xml"
VIEWS = "scenes/cornell_box/views.yaml"
ALL = ("scene", "reference", "photons", "train", "render", "metrics", "amortize")


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
        fresh, "scene", r"params\.yaml: cannot be read\. Run `gpf` in the project folder"
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
            r"error: --passes 250: is not a range .*\. Write it as FIRST:LAST",
        ),
        ("reference", "a:b", r"--passes a:b: is not a range"),
        ("reference", "3:3", r"--passes 3:3: is not within the 4 passes of params\.yaml"),
        ("reference", "0:400", r"--passes 0:400: is not within the 4 passes"),
        ("train", "0:2", r"No such option: --passes"),
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
        [sys.executable, "-m", "gpf.cli", "stage", "train", "--scene", "cornell_box"],
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


def test_training_views_that_see_nothing_diffuse(finished, no_probe):
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
    finished.edit("params.yaml", visible_region__use=False)
    assert finished.stage("reference").code == 0
    assert_refused(
        finished,
        "train",
        r"error: train\.points: 'both' selects none of 0 targets\. Choose another, or set "
        r"reference\.surface_points above 0",
    )


def test_a_repository_without_a_commit(finished):
    subprocess.run(["git", "init", "--quiet"], cwd=finished.folder, check=True)
    subprocess.run(
        [sys.executable, "-m", "dvc", "init", "--quiet"], cwd=finished.folder, check=True
    )
    finished.edit("params.yaml", train__seed=5)
    assert_refused(finished, "train", r"error: git: has no commit here .*Run `git add -A")


@pytest.mark.parametrize("stage", ["reference", "photons"])
def test_a_material_that_cannot_be_traced(fresh, stage):
    bump = '<bsdf type="bumpmap"><texture type="checkerboard"/><bsdf type="diffuse"/></bsdf>'
    fresh.replace(XML, "</scene>", f'<shape type="sphere">{bump}</shape></scene>')
    assert fresh.stage("scene").code == 0
    words = r"scene 'cornell_box': cannot be traced: .* Give the bumpmap a bitmap"
    assert_refused(fresh, stage, words)
    gc.collect()  # the error's traceback holds the scene, and Dr.Jit traces through all that exist
