"""`gpf cache`: what is kept in the user's cache, and how much room it takes."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import Any

from rich.table import Table

from gpf.blender.conversion import RECORD, scenes_folder
from gpf.blender.process import installed_python
from gpf.core.errors import UserError
from gpf.core.files import read_json
from gpf.core.partial import remove_leftovers
from gpf.core.progress import console, say


def show_cache(clear: str | None) -> None:
    """List the scenes that were converted, and the Blender that was installed, or remove them.

    ``clear``: "scenes" to remove the scenes, "all" to remove Blender, too.
    """
    scenes, blender = scenes_folder(), installed_python().parent.parent
    remove_leftovers(scenes)
    kept = {path: _source(path) for path in sorted(scenes.glob("*/"))}
    kept |= {blender: "Blender"} if blender.is_dir() else {}
    sizes = {path: sum(f.lstat().st_size for f in path.rglob("*")) / 1e6 for path in kept}
    if clear is not None:
        removed = [path for path in kept if clear == "all" or path != blender]
        for path in removed:
            shutil.rmtree(path)
        say(f"{scenes.parent}: removed {sum(sizes[path] for path in removed):.0f} MB")
        return
    table = Table("from", "made", "MB")
    for path, source in kept.items():
        made = time.strftime("%Y-%m-%d", time.localtime(path.stat().st_mtime))
        table.add_row(source, made, f"{sizes[path]:.0f}")
    console.print(table, markup=False)
    say(f"{scenes.parent}: {sum(sizes.values()):.0f} MB; to remove it, --clear scenes or all")


def _source(folder: Path) -> str:
    """The file that a scene was converted from."""
    try:
        return str(read_json(folder / RECORD, dict[str, Any])["file"])
    except (UserError, KeyError):  # of an earlier version, or damaged
        return folder.name
