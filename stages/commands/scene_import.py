"""`gpf scene import`: adds a foreign scene to scenes/ and to params.yaml."""

from __future__ import annotations

import re
from pathlib import Path

from rich.console import Console

from gpf.core.files import write_text
from gpf.core.progress import console
from gpf.core.runtime import choose_variant
from gpf.core.yaml import load_yaml
from gpf.scene.folders import scenes_root
from stages.commands.profiles import dump_yaml, open_yaml
from stages.config.params import Params, read_params
from stages.importing.description import print_report
from stages.importing.importer import import_scene
from stages.importing.views import place_views


def import_into_project(path: Path, name: str) -> None:
    """Import a scene, print a report, and add the scene to the project's params.yaml, if any."""
    root = scenes_root()
    file = root.parent / "params.yaml"
    if file.is_relative_to(Path.cwd()):
        file = file.relative_to(Path.cwd())
    params = read_params(file) if file.exists() else None
    choose_variant(params.runtime.variant if params else "auto")
    with console.status(f"{name}: copying, tracing, placing views"):
        report = import_scene(path, name, place_views, root)
    out = Console(highlight=False, soft_wrap=True)
    print_report(report, out)
    if params is not None and add_scene(name, file):
        out.print(f"{file}: {name} added to scenes")
    out.print(
        f"Next: `gpf scene preview {name}` shows its views; `dvc repro` runs the whole pipeline; "
        f"`gpf stage scene --scene {name}` runs its first stage."
    )


def add_scene(name: str, file: Path) -> bool:
    """Add a scene to params.yaml, keeping comments and other lines; False if it is already
    listed."""
    text = file.read_text(encoding="utf-8")
    yaml, document = open_yaml(text, str(file))
    scenes = document["scenes"]
    if name in scenes:
        return False
    lines = text.splitlines(keepends=True)
    last = scenes.lc.item(len(scenes) - 1)[0]
    item = re.match(r"(\s*-\s+)\S", lines[last])
    if item:  # insert a line, so that comments after the list stay after it
        lines[last] = lines[last].rstrip("\n") + "\n"
        lines.insert(last + 1, f"{item[1]}{name}\n")
        text = "".join(lines)
    else:  # a list in the style [a, b]
        scenes.append(name)
        text = dump_yaml(yaml, document)
    Params.model_validate(load_yaml(text, str(file)))
    write_text(file, text)
    return True
