"""What a stage's code is: which files, and when it counts as another."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from gpf.config import read_params
from stages import imports
from stages.cli import STAGES
from stages.code import files_of_baseline, files_of_scene, files_of_stage
from stages.code_digest import digest_file
from stages.imports import NO_INFLUENCE, PACKAGES, PROJECT, TAKES_ALONG, closure

PARAMS = read_params(PROJECT / "params.yaml")

# What a stage's module loads, beyond what those without influence have loaded.
LOADED = """
import importlib, json, sys
from gpf.runtime import choose_variant
choose_variant("auto")
stage, *idle = sys.argv[1:]
for module in idle:
    importlib.import_module(module)
before = set(sys.modules)
importlib.import_module(stage)
print(json.dumps(sorted(set(sys.modules) - before)))
"""


@pytest.mark.parametrize("stage", ["reference", "train", "ablation", "report"])
def test_all_that_python_loads_is_among_it(stage, environment):
    module = STAGES[stage][0]
    idle = [f.removesuffix(".py").removesuffix("/__init__") for f in sorted(NO_INFLUENCE)]
    done = subprocess.run(
        [sys.executable, "-c", LOADED, module, *(name.replace("/", ".") for name in idle)],
        env=environment(PYTHONPATH=str(PROJECT)),
        capture_output=True,
        text=True,
        check=True,
    )
    names = json.loads(done.stdout.splitlines()[-1])
    loaded = {n.replace(".", "/") for n in names if n.split(".")[0] in PACKAGES}
    assert len(loaded) > 3 and module.replace(".", "/") in loaded
    files = {
        file.removesuffix(".py").removesuffix("/__init__") for file in files_of_stage(stage, PARAMS)
    }
    assert loaded <= files


@pytest.fixture
def project(tmp_path, monkeypatch) -> Path:
    """Modules that import each other."""
    texts = {
        "gpf/__init__.py": "import gpf.unseen",
        "gpf/a.py": "from gpf import b\n\n\ndef f():\n    import metrics.deep.c as c\n    return c",
        "gpf/b.py": "from gpf.errors import UserError\nimport gpf.a",
        "gpf/errors.py": "import gpf.unseen",
        "gpf/unseen.py": "",
        "gpf/alone.py": "import numpy",
        "metrics/deep/__init__.py": "",
        "metrics/deep/c.py": "",
        "metrics/deep/data.json": "{}",
        "tests/d.py": "",
    }
    for name, text in texts.items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    monkeypatch.setattr(imports, "PROJECT", tmp_path)
    imports.imports_of.cache_clear()
    yield tmp_path
    imports.imports_of.cache_clear()


def test_imports_are_followed_wherever_they_are(project):
    """In functions, in circles, of packages; not through what has no influence."""
    found = ["gpf/a.py", "gpf/b.py", "metrics/deep/__init__.py", "metrics/deep/c.py"]
    assert closure("gpf/a.py") == found
    assert closure("gpf/alone.py") == ["gpf/alone.py"]
    assert closure("gpf/a.py", without=["gpf/b.py"]) == [f for f in found if f != "gpf/b.py"]


def test_what_no_import_tells_of_is_taken_along(project, monkeypatch):
    monkeypatch.setitem(TAKES_ALONG, "gpf/alone.py", ("metrics/deep/*.*",))
    found = [f"metrics/deep/{name}" for name in ("__init__.py", "c.py", "data.json")]
    assert closure("gpf/alone.py") == ["gpf/alone.py", *found]


def test_what_is_taken_along_exists():
    for file, patterns in TAKES_ALONG.items():
        assert (PROJECT / file).exists()
        assert all(list(PROJECT.glob(pattern)) for pattern in patterns), file


def test_the_page_is_more_than_python():
    files = files_of_stage("report", PARAMS)
    assert {"report/page/flipbook.js", "report/page/template.html", "report/paper.yaml"} <= set(
        files
    )


def test_each_system_has_its_own_files():
    files = {method: files_of_baseline(row) for method, row in PARAMS.baselines.items()}
    assert "gpf/baselines/splatting.py" in files["splatting_3"]
    assert "gpf/baselines/splatting.py" not in files["instant_ngp_3"]
    assert "gpf/baselines/programs/infer_with_anysplat.py" in files["anysplat_3"]
    for_targets = {m for m, found in files.items() if "stages/field_effort.py" in found}
    assert for_targets == {"radiance_cache", "radiance_cache_small"}


def test_builders_of_scenes_are_read_for_what_they_import(monkeypatch):
    monkeypatch.chdir(PROJECT)
    files = {scene: files_of_scene(scene) for scene in PARAMS.scenes}
    assert all("gpf/scene_freezing.py" in found for found in files.values())
    assert "gpf/modelling/teapot.py" in files["veach_ajar"]
    assert "gpf/modelling/teapot.py" not in files["cornell_box"]


def test_one_file_for_each_stage_and_system(fresh):
    assert fresh.stage("code").code == 0
    folder = fresh.folder / "results" / "code"
    assert {file.stem for file in folder.glob("*.txt")} == set(STAGES) - {
        "code",
        "baseline",
        "scene",
    }
    rows = read_params(fresh.folder / "params.yaml").baselines
    assert {file.stem for file in folder.glob("baselines/*.txt")} == set(rows)
    scenes = {file.stem for file in folder.glob("scenes/*.txt")}
    assert scenes == set(read_params(fresh.folder / "params.yaml").scenes)
    lines = [line.split("  ") for line in (folder / "render.txt").read_text().splitlines()]
    assert [file for _, file in lines] == files_of_stage("render", PARAMS)
    assert [digest_file(PROJECT / "gpf/field.py"), "gpf/field.py"] in lines


def test_comments_and_layout_do_not_count_what_is_done_does(tmp_path):
    texts = [
        'def f(x):\n    """Says this."""\n    return x + 1',
        'def f(x):\n    """Says that."""\n    # why\n    return (x\n            + 1)',
        'def f(x):\n    """Says this."""\n    return x + 2',
    ]
    file = tmp_path / "f.py"
    digests = [file.write_text(text) and digest_file(file) for text in texts]
    assert digests[0] == digests[1] != digests[2]


def test_python_versions_agree(tmp_path, monkeypatch):
    """Since 3.12, functions and classes have `type_params`, mostly none."""
    file = tmp_path / "f.py"
    file.write_text(
        "def f(x: int, *, y=None) -> str:\n    return f'{x}'\n\n\nclass A:\n    b = None\n"
    )
    assert digest_file(file) == "34d10e3b1ff72665"


def test_every_byte_of_other_files_counts(tmp_path):
    file = tmp_path / "style.css"
    digests = [file.write_bytes(text) and digest_file(file) for text in (b"a {}", b"a  {}")]
    assert digests[0] != digests[1]
