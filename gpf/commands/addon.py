"""`gpf blender-addon`: the add-on for Blender, to install from disk."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from gpf.commands.overwriting import require_new_folder
from gpf.core.files import write_json
from gpf.core.partial import grant_as_usual, partial_folder, replace_folder
from gpf.core.progress import say

SOURCE = Path(__file__).parents[1] / "blender" / "addon"
FILES = {"photon_field.py": "__init__.py", "blender_manifest.toml": "blender_manifest.toml"}
"""The files of the add-on, and what they are called in it."""


def write_addon(output: Path, overwrite: bool) -> None:
    """Write a folder with the add-on, which starts the `gpf` that wrote it.

    Raises
    ------
    UserError: the folder exists and is not to be replaced, or holds something else.
    """
    require_new_folder(output, "blender_manifest.toml", overwrite)
    output.parent.mkdir(parents=True, exist_ok=True)
    with partial_folder(output) as new:
        for source, name in FILES.items():
            shutil.copyfile(SOURCE / source, new / name)
        command = [sys.executable, "-m", "gpf.commands.blender_engine"]
        write_json(new / "command.json", {"command": command})
        grant_as_usual(new)
        replace_folder(new, output)
    say(f"{output}: in Blender, Preferences, Add-ons, Install from Disk; or copy it to the folder")
    say("of your extensions. Then choose the render engine Photon Field, and press F12.")
