"""Where a killed run left what it had, for the next one with the same task."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gpf.core.files import write_text


def open_state(folder: Path, task: Mapping[str, Any]) -> Path:
    """The folder as it was left, if that was by the same task; else an empty one."""
    text = json.dumps(task, indent=2, sort_keys=True) + "\n"
    file = folder / "task.json"
    if not file.exists() or file.read_text(encoding="utf-8") != text:
        shutil.rmtree(folder, ignore_errors=True)
        write_text(file, text)
    return folder
