"""`gpf blender-addon`: the add-on for Blender, to install from disk."""

from __future__ import annotations

import io
import json
import sys
import zipfile
from pathlib import Path

from gpf.commands.overwriting import require_new
from gpf.core.errors import UserError
from gpf.core.files import write_atomically
from gpf.core.progress import say

SOURCE = Path(__file__).parents[1] / "blender" / "addon"
FILES = {"photon_field.py": "__init__.py", "blender_manifest.toml": "blender_manifest.toml"}
"""The files of the add-on, and what they are called in it."""


def write_addon(output: Path, overwrite: bool) -> None:
    """Write a zip file with the add-on, which starts the `gpf` that wrote it.

    Raises
    ------
    UserError: the name does not end in ``.zip``, or the file exists and is not to be replaced.
    """
    if output.suffix != ".zip":
        raise UserError(str(output), "is not the name of a zip file", "Let it end in .zip.")
    require_new(output, overwrite)
    contents = {name: (SOURCE / source).read_bytes() for source, name in FILES.items()}
    command = {"command": [sys.executable, "-m", "gpf.commands.blender_engine"]}
    contents["command.json"] = json.dumps(command).encode()
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    write_atomically(output, lambda path: path.write_bytes(data.getvalue()))
    say(f"{output}: in Blender, Preferences, Add-ons, Install from Disk. Then choose the render")
    say("engine Photon Field, and press F12.")
