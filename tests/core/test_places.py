"""Places of files whose names others have chosen."""

from __future__ import annotations

from pathlib import Path

import pytest

from gpf.core.errors import UserError
from gpf.core.places import make_place, place_below


@pytest.mark.parametrize(
    "name",
    [
        "..",
        "../x",
        "../home/x",
        "a/../../home/x",
        "a/../..",
        "/x",
        "/",
        "out/x",
        "out",
        "a/../out/x",
    ],
)
def test_no_way_leads_out_of_the_folder(tmp_path, name):
    home = tmp_path / "home"
    home.mkdir()
    (tmp_path / "outside").mkdir()
    (home / "out").symlink_to(tmp_path / "outside")
    for place in (place_below, make_place):
        with pytest.raises(UserError, match=r"^scene\.xml:3: refers to .* leads out of the folder"):
            place(home, name, "scene.xml:3")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["home", "out", "outside"]


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("x", "x"),
        (".", ""),
        ("a/../b/x", "b/x"),
        ("..x/a..b", "..x/a..b"),
        ("a/b/../../c", "c"),
        ("in/x", "deep/x"),
    ],
)
def test_ways_inside_are_made(tmp_path, name, place):
    home = tmp_path / "home"
    (home / "deep").mkdir(parents=True)
    (home / "in").symlink_to(home / "deep")
    assert place_below(home, name, "") == home / place
    made = make_place(home, name, "")
    assert made == home / place
    assert (home / name).parent.is_dir() and made.parent.is_dir()


def test_the_folder_itself_may_be_a_link(tmp_path, monkeypatch):
    (tmp_path / "home").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "home")
    assert place_below(tmp_path / "link", "a/../x", "") == tmp_path / "link/x"
    monkeypatch.chdir(tmp_path)
    assert place_below(Path("link"), "x", "") == Path("link/x")
