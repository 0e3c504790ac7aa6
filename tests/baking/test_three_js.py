"""three.js comes from where it is published, is checked, and is kept."""

from __future__ import annotations

import shutil
import urllib.request
from pathlib import Path

import pytest

from gpf.baking import three_js
from gpf.baking.three_js import FILES, find_three, kept_three
from gpf.core.errors import UserError


@pytest.fixture(scope="module")
def real() -> Path:
    return find_three()


@pytest.fixture
def empty_cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return kept_three()


def test_it_is_kept(real, monkeypatch):
    monkeypatch.setattr(three_js, "_from_npm", None)
    monkeypatch.setattr(three_js, "_from_cdn", None)
    assert find_three() == real and all((real / name).is_file() for name in FILES)


def test_without_npm_it_comes_from_the_network(real, empty_cache, monkeypatch):
    def open_file(address: str, timeout: float):
        assert address.startswith(f"https://cdn.jsdelivr.net/npm/three@{three_js.VERSION}/")
        return (real / address.split("@")[1].split("/", 1)[1]).open("rb")

    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(urllib.request, "urlopen", open_file)
    assert find_three() == empty_cache
    assert {f.relative_to(empty_cache).as_posix() for f in empty_cache.rglob("*.*s")} <= set(FILES)


def test_what_arrives_is_checked(real, empty_cache, monkeypatch, tmp_path):
    (tmp_path / "other.js").write_text("alert(1)")
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(
        urllib.request, "urlopen", lambda *_, timeout: (tmp_path / "other.js").open("rb")
    )
    with pytest.raises(UserError, match=r"has files of another version than .*--three FOLDER"):
        find_three()
    assert not empty_cache.exists() and not [*empty_cache.parent.iterdir()]


def test_no_network_is_said(empty_cache, monkeypatch):
    def fail(*_, timeout: float):
        raise OSError("no route to host")

    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(urllib.request, "urlopen", fail)
    with pytest.raises(UserError, match=r"cannot be had: .*npm.*; no route to host\. Give"):
        find_three()


def test_what_npm_says_is_told(empty_cache, monkeypatch, tmp_path):
    (tmp_path / "npm").write_text("#!/bin/sh\necho 404 for you >&2\nexit 1\n")
    (tmp_path / "npm").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin")
    monkeypatch.setattr(three_js, "_from_cdn", three_js._from_npm)
    with pytest.raises(UserError, match=r"npm: 404 for you; npm: 404 for you"):
        find_three()


def test_a_folder_may_be_given(real, tmp_path, empty_cache):
    shutil.copytree(real, tmp_path / "three")
    assert find_three(tmp_path / "three") == tmp_path / "three"
    (tmp_path / "three/LICENSE").unlink()
    with pytest.raises(UserError, match=r"--three .*three: has no LICENSE\."):
        find_three(tmp_path / "three")
    assert not empty_cache.exists()
