"""YAML that a few bytes make large: names for parts (`&a`) that are repeated (`*a`)."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest
from pydantic import ValidationError

from gpf.core.errors import UserError
from gpf.core.yaml import MOST_REPEATED, explain, load_yaml
from gpf.scene.views import SceneViews, read_views
from stages.common import code

PROJECT = Path(__file__).parents[2]


def bomb(rows: int, row: str, first: str = "[x]") -> str:
    """Each name stands for nine times the one before."""
    lines = [f"n{k}: &n{k} {row.format(', '.join([f'*n{k - 1}'] * 9))}" for k in range(1, rows)]
    return "\n".join([f"n0: &n0 {first}", *lines, ""])


LISTS = bomb(9, "[{}]") + "views: {train: [{name: a, origin: *n8, target: *n8, fov: *n8}]}\n"
MERGED = bomb(9, "{{<<: [{}]}}", "{x: 1}") + "views: *n8\n"
WIDE = f"wide: &w [{', '.join(['lamp'] * 2000)}]\n" + "".join(f"g{k}: *w\n" for k in range(2000))
LONG = f"long: &l {'x' * 5000}\nall: [{', '.join(['*l'] * 5000)}]\n"
ENDLESS = "views: &v {train: *v}\n"
BOMBS = {"lists": LISTS, "merged": MERGED, "wide": WIDE, "long": LONG, "endless": ENDLESS}

# Reads files in all ways with little more memory than there is at the beginning.
READER = """
import resource, sys
from pathlib import Path
import gpf.scene.views, gpf.scene.light_groups, stages.config.params, stages.commands.profiles
from gpf.core.errors import UserError
from gpf.core.yaml import read_yaml
from gpf.scene.light_groups import _Listed
ways = {
    "views": gpf.scene.views.read_views,
    "params": stages.config.params.read_params,
    "groups": lambda file: read_yaml(file, _Listed, ""),
    "profiles": lambda file: stages.commands.profiles.open_yaml(file.read_text(), str(file)),
}
pages = int(Path("/proc/self/statm").read_text().split()[0])
limit = pages * resource.getpagesize() + 64 * 2**20
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
for name in sys.argv[1:]:
    for way, read in ways.items():
        try:
            read(Path(name))
            print(f"{name}: is read by {way}")
        except UserError as error:
            print(error)
"""


def test_bombs_are_refused_with_little_memory(tmp_path):
    files = [tmp_path / f"{name}.yaml" for name in BOMBS]
    for file, text in zip(files, BOMBS.values(), strict=True):
        file.write_text(text)
    done = subprocess.run(
        [sys.executable, "-c", READER, *map(str, files)],
        cwd=PROJECT,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 4 * len(files)
    for line, file in zip(lines, [file for file in files for _ in range(4)], strict=True):
        assert re.match(rf"{re.escape(str(file))}: (repeats|uses) ", line), line


def test_the_pipelines_own_file_is_read_so_too(tmp_path, monkeypatch):
    (tmp_path / "dvc.yaml").write_text(LISTS)
    monkeypatch.setattr(code, "PROJECT", tmp_path)
    with pytest.raises(UserError, match=r"dvc\.yaml: repeats more than .* through aliases .*\*n"):
        code.code_of.__wrapped__("scene")


def test_names_for_parts_can_be_used(tmp_path):
    file = tmp_path / "views.yaml"
    file.write_text(
        "views:\n  train:\n"
        "    - &front {name: front, origin: &o [0, 1, 4], target: [0, 0, 0], fov: 40}\n"
        "    - {<<: *front, name: left}\n"
        "    - {name: far, origin: *o, target: [1, 0, 0], fov: 40}\n"
    )
    views = read_views(file).train
    assert [view.name for view in views] == ["front", "left", "far"]
    assert [view.origin for view in views] == [(0, 1, 4)] * 3


def test_the_limit_counts_what_is_repeated_alone():
    """A long file without repetitions is read."""
    text = f"a: &a [1]\nb: *a\nlong: {'x' * 2 * MOST_REPEATED}\n"
    assert load_yaml(text, "file")["b"] == [1]
    short = "a: &a " + "x" * 99 + "\nb: [" + ", ".join(["*a"] * (MOST_REPEATED // 100)) + "]\n"
    assert len(load_yaml(short, "file")["b"]) == MOST_REPEATED // 100
    with pytest.raises(UserError, match=r"^file: repeats more than 100,000 char.* as \*a\. Rep"):
        load_yaml(short.replace("[", "[*a, "), "file")


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ([[0] * 1000] * 10_000, "[[0, 0, 0"),
        ({"x": ["y"] * 10**7}, "{'x': ['y', 'y'"),
        ("x" * 10**7, "'xxxxxx"),
        ([1, 2, 3], "[1, 2, 3]"),
        (-1, "-1"),
    ],
)
def test_long_values_are_cut_before_they_are_written(value, told):
    with pytest.raises(ValidationError) as caught:
        SceneViews.model_validate({"exposure": value, "views": {}})
    tracemalloc.start()
    try:
        error = explain("views.yaml", SceneViews, caught.value)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 2**20
    assert error.what.startswith(f"is {told}") and len(error.what) <= len("is ") + 60


def test_all_yaml_is_read_in_this_way():
    """No other module calls the library's own `load`."""
    found = []
    for folder in (
        "gpf",
        "baselines",
        "stages",
        "metrics",
        "report",
        "tools",
        "benchmarks",
        "docs",
        "examples",
    ):
        for file in (PROJECT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Attribute) and node.attr.startswith("load"):
                    if "yaml" in ast.unparse(node.value).lower():
                        found.append(file.relative_to(PROJECT).as_posix())
    assert found == ["gpf/core/yaml.py"]
