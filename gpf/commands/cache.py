"""`gpf cache`: what is kept in the user's cache, and how much room it takes."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

from gpf.baking.three_js import kept_three
from gpf.blender.conversion import origin_of, scenes_folder
from gpf.blender.process import installed_python
from gpf.core.partial import remove_leftovers
from gpf.core.progress import say


def show_cache(clear: str | None) -> None:
    """List the scenes that were converted, and the programs that were installed.

    ``clear``: "scenes" to remove the scenes before, "all" to remove the programs, too.
    """
    scenes = scenes_folder()
    programs = {installed_python().parent.parent: "Blender", kept_three(): "three.js"}
    for folder in (scenes, scenes.parent):
        remove_leftovers(folder)
    total = 0.0
    for folder in (*sorted(scenes.glob("*/")), *filter(Path.is_dir, programs)):
        if clear == "all" or (clear == "scenes" and folder not in programs):
            shutil.rmtree(folder)
            continue
        size = sum(file.lstat().st_size for file in folder.rglob("*")) / 1e6
        made = time.strftime("%Y-%m-%d", time.localtime(folder.stat().st_mtime))
        source = programs.get(folder) or str(origin_of(folder / "scene.xml"))
        say(f"{size:6.0f} MB  {made}  {source}")
        total += size
    say(f"{scenes.parent}: {total:.0f} MB; `--clear scenes` or `--clear all` removes them")
