"""What a stage's code is: which files, and when it counts as another."""

from __future__ import annotations

import json
import os
import re
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

# All imports as they happen: who imports, and what.
TRACED = """
import builtins, importlib, json, sys
plain, told = builtins.__import__, []
def traced(name, globals=None, locals=None, fromlist=(), level=0):
    module = plain(name, globals, locals, fromlist, level)
    parts = [f"{name}.{part}" for part in fromlist or ()]
    told.append([(globals or {}).get("__name__"), [name, *parts]])
    return module
builtins.__import__ = traced
from gpf.runtime import choose_variant
choose_variant("auto")
for module in sys.argv[1:]:
    importlib.import_module(module)
print(json.dumps([told, list(sys.modules)]))
"""


@pytest.fixture(scope="module")
def imported() -> dict[str, set[str]]:
    """Module -> modules of the project that it has imported, when all stages were loaded."""
    systems = {f"gpf.baselines.{options.system}" for options in PARAMS.baselines.values()}
    modules = [module for module, _ in STAGES.values()]
    done = subprocess.run(
        [sys.executable, "-c", TRACED, *modules, *sorted(systems)],
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
        check=True,
    )
    told, loaded = json.loads(done.stdout.splitlines()[-1])
    found: dict[str, set[str]] = {}
    for importer, names in told:
        ours = {name for name in names if name.split(".")[0] in PACKAGES and name in loaded}
        found.setdefault(importer, set()).update(ours)
    return found


def module_of(file: str) -> str:
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


@pytest.mark.parametrize("stage", [stage for stage in STAGES if stage != "code"])
def test_all_that_python_loads_is_among_it(stage, imported):
    """Python's own imports, against what the text says."""
    if stage in ("scene", "baseline"):
        names = [*PARAMS.scenes] if stage == "scene" else [*PARAMS.baselines.values()]
        of = files_of_scene if stage == "scene" else files_of_baseline
        files = set().union(*(of(name) for name in names))
    else:
        files = set(files_of_stage(stage, PARAMS))
    idle = {module_of(file) for file in NO_INFLUENCE}
    loaded: set[str] = set()
    waiting = [STAGES[stage][0]]
    while waiting:
        module = waiting.pop()
        if module not in loaded | idle:
            loaded.add(module)
            waiting += imported.get(module, ())
    assert len(loaded) > 10
    assert loaded <= {module_of(file) for file in files}


# Files that load or read others, and why these need not be taken along.
KNOWN = {
    "gpf/baselines/optional.py": "packages of others",
    "gpf/baselines/programs/conversation.py": "packages of others",
    "gpf/baselines/programs/infer_with_anysplat.py": "packages of others",
    "gpf/baselines/programs/render_with_renderformer.py": "packages of others",
    "gpf/baselines/registry.py": "the system of a row of params.yaml, see files_of_baseline",
    "gpf/scene_freezing.py": "the scene's builder, see files_of_scene",
    "stages/reference_records.py": "the text of files that are among the imports",
}


def test_who_loads_or_reads_files_of_the_project_takes_them_along():
    stages = [stage for stage in STAGES if stage not in ("code", "scene", "baseline")]
    files = set().union(
        *(files_of_stage(stage, PARAMS) for stage in stages),
        *(files_of_scene(scene) for scene in PARAMS.scenes),
        *(files_of_baseline(options) for options in PARAMS.baselines.values()),
    )
    loads = re.compile(r'__file__|"type": "(gpf|sppm)"|import_module\(|spec_from_file_location')
    texts = {f: (PROJECT / f).read_text(encoding="utf-8") for f in files if f.endswith(".py")}
    found = {file for file, text in texts.items() if loads.search(text)}
    assert found == (set(TAKES_ALONG) | set(KNOWN))


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
