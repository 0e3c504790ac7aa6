"""Rows of params.yaml, one after another, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path


def run_each(stage: str, scene: str, option: str, names: Sequence[str]) -> None:
    """``gpf stage STAGE --scene SCENE --OPTION NAME --go-on`` for each name."""
    # Also where the project is not installed, but imported from a folder.
    places = [str(Path(__file__).parent.parent), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, places))}
    for name in names:
        command = ["stage", stage, "--scene", scene, f"--{option}", name, "--go-on"]
        whole = [sys.executable, "-m", "stages.cli", *command]
        subprocess.run(whole, check=True, env=environment)
