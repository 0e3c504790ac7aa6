"""`gpf scene list`: a table of the scenes."""

from __future__ import annotations

import re
from pathlib import Path
from textwrap import shorten

from rich.console import Console
from rich.table import Table
from rich.text import Text

from gpf.core.errors import UserError
from gpf.scene.folders import list_scenes, load_views, scenes_root
from stages.config.params import read_params


def print_scenes() -> None:
    """Print the scenes: name, numbers of views, whether params.yaml lists them, a description."""
    root = scenes_root()
    file = root.parent / "params.yaml"
    listed = read_params(file).scenes if file.exists() else ()
    table = Table("scene", "training", "novel", "frames", "in params.yaml", "what it is", box=None)
    for name in list_scenes(root):
        try:
            views = load_views(name, root)
        except UserError as error:
            where = error.where.rpartition("/")[2]
            table.add_row(name, "", "", "", "", Text(f"{where} {error.what}", "red"))
            continue
        numbers = [str(len(v)) for v in (views.train, views.novel, views.frames())]
        table.add_row(name, *numbers, "yes" if name in listed else "no", _about(root / name))
    Console(highlight=False).print(table)


def _about(folder: Path) -> str:
    """The first paragraph of a scene's README, shortened and without Markdown."""
    readme = folder / "README.md"
    text = readme.read_text(encoding="utf-8", errors="replace") if readme.exists() else ""
    paragraphs = text.split("\n\n")
    return shorten(re.sub(r"[`*]", "", paragraphs[1]), 64) if len(paragraphs) > 1 else ""
