"""Rows of params.yaml, one after another, each in a separate process."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from gpf.core.errors import UserError


def run_each(stage: str, scene: str, option: str, names: Sequence[str]) -> None:
    """Run ``gpf stage STAGE --scene SCENE --OPTION NAME --go-on`` for each name.

    Raises
    ------
    UserError: at the end, if some of them failed; each has printed its reason.
    """
    # The project may be imported from a folder without being installed.
    places = [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, places))}
    failed = []
    for name in names:
        command = ["stage", stage, "--scene", scene, f"--{option}", name, "--go-on"]
        whole = [sys.executable, "-m", "gpf.cli", *command]
        if subprocess.run(whole, check=False, env=environment).returncode:
            failed.append(name)
    if failed:
        again = f"gpf stage {stage} --scene {scene} --{option} {failed[0]}"
        raise UserError(
            f"stage {stage}, {scene}",
            f"{len(failed)} of {len(names)} failed: {', '.join(failed)}",
            f"Their messages are above; `{again}` repeats the first.",
        )
