"""`gpf cache` shows what is kept, and removes it."""

from __future__ import annotations

from gpf.baking.three_js import kept_three
from gpf.blender.conversion import RECORD, scenes_folder
from gpf.blender.process import installed_python
from gpf.cli import main
from gpf.core.files import write_json


def gpf_cache(capfd, *words: str) -> str:
    try:
        main(["cache", *words])
    except SystemExit as outcome:
        assert outcome.code == 0
    return "".join(capfd.readouterr())


def test_the_cache_is_shown_and_cleared(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert ": 0 MB" in gpf_cache(capfd)
    pool, old = (scenes_folder() / name for name in ("pool-1", "old-2"))
    programs = (installed_python().parent, 10**7), (kept_three(), 2_000_000)
    for folder, size in ((pool, 3_000_000), (old, 1_000_000), *programs):
        folder.mkdir(parents=True)
        (folder / "data").write_bytes(bytes(size))
    write_json(pool / RECORD, {"file": "/home/me/[/pool].blend"})
    (scenes_folder() / ".gpf-partial-half").mkdir()
    lines = [line.split() for line in gpf_cache(capfd).splitlines()]
    assert [(line[0], line[-1]) for line in lines[:4]] == [
        ("1", str(old / "scene.xml")),
        ("3", "/home/me/[/pool].blend"),
        ("10", "Blender"),
        ("2", "three.js"),
    ]
    assert ": 12 MB" in gpf_cache(capfd, "--clear", "scenes")
    assert not [*scenes_folder().iterdir()] and installed_python().parent.is_dir()
    assert ": 0 MB" in gpf_cache(capfd, "--clear", "all")
    assert not [*(tmp_path / "gpf").rglob("data")]
