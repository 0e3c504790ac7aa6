"""`gpf cache`: what is kept in the user's cache, and how much room it takes."""

from __future__ import annotations

import shutil
import time

from gpf.blender.conversion import origin_of, scenes_folder
from gpf.blender.process import installed_python
from gpf.core.partial import remove_leftovers
from gpf.core.progress import say


def show_cache(clear: str | None) -> None:
    """List the scenes that were converted, and the Blender that was installed.

    ``clear``: "scenes" to remove the scenes before, "all" to remove Blender, too.
    """
    scenes, blender = scenes_folder(), installed_python().parent.parent
    remove_leftovers(scenes)
    total = 0.0
    for folder in (*sorted(scenes.glob("*/")), *blender.parent.glob(blender.name)):
        if clear == "all" or (clear == "scenes" and folder != blender):
            shutil.rmtree(folder)
            continue
        size = sum(file.lstat().st_size for file in folder.rglob("*")) / 1e6
        made = time.strftime("%Y-%m-%d", time.localtime(folder.stat().st_mtime))
        source = "Blender" if folder == blender else str(origin_of(folder / "scene.xml"))
        say(f"{size:6.0f} MB  {made}  {source}")
        total += size
    say(f"{scenes.parent}: {total:.0f} MB; `--clear scenes` or `--clear all` removes them")
