"""`gpf cache` shows what is kept, and removes it."""

from __future__ import annotations

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
    monkeypatch.setenv("COLUMNS", "400")
    assert ": 0 MB" in gpf_cache(capfd)
    pool, old = (scenes_folder() / name for name in ("pool-1", "old-2"))
    for folder, size in ((pool, 3_000_000), (old, 1_000_000), (installed_python().parent, 10**7)):
        folder.mkdir(parents=True)
        (folder / "data").write_bytes(bytes(size))
    write_json(pool / RECORD, {"file": "/home/me/[/pool].blend"})
    (scenes_folder() / ".gpf-partial-half").mkdir()
    shown = {
        line.split("\u2502")[1].strip(): line
        for line in gpf_cache(capfd).splitlines()
        if "\u2502" in line
    }
    assert list(shown) == [str(old / "scene.xml"), "/home/me/[/pool].blend", "Blender"]
    assert " 3 " in shown["/home/me/[/pool].blend"] and " 10 " in shown["Blender"]
    assert ": 10 MB" in gpf_cache(capfd, "--clear", "scenes")
    assert not [*scenes_folder().iterdir()] and installed_python().parent.is_dir()
    assert ": 0 MB" in gpf_cache(capfd, "--clear", "all")
    assert not [*(tmp_path / "gpf").rglob("data")]
