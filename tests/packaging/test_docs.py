"""The pages of docs/: links lead to files, each page is listed, the API page has all names."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import gpf

PROJECT = Path(__file__).parents[2]
PAGES = sorted((PROJECT / "docs").glob("*.md"))
API = (PROJECT / "docs" / "api.md").read_text(encoding="utf-8").split()


@pytest.mark.parametrize("page", [*PROJECT.glob("*.md"), *PAGES], ids=lambda page: page.name)
def test_links_lead_to_files(page):
    targets = re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))
    files = {target.partition("#")[0] for target in targets if "://" not in target}
    assert [file for file in files if not (page.parent / file).exists()] == []


def test_each_page_is_in_a_toctree():
    index = (PROJECT / "docs" / "index.md").read_text(encoding="utf-8")
    trees = re.findall(r"^```\{toctree\}\n(.*?)^```", index, flags=re.MULTILINE | re.DOTALL)
    listed = [line for tree in trees for line in tree.split("\n") if line and line[0] != ":"]
    assert sorted(["index", *listed]) == [page.stem for page in PAGES]


def test_the_api_page_has_each_public_name():
    names = {name: getattr(gpf, name).__module__ for name in gpf.__all__}
    assert [name for name, module in names.items() if f"~{module}.{name}" not in API] == []


def test_the_api_page_has_each_package():
    folders = [file.parent for file in PROJECT.glob("gpf/*/**/__init__.py")]
    packages = {".".join(folder.relative_to(PROJECT).parts) for folder in folders}
    # Scripts for other environments: they cannot be imported.
    packages -= {"baselines.programs"}
    assert packages - {*API} == set()
