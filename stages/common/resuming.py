"""Folders in which a killed run leaves its state for the next run of the same task."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gpf.core.files import write_text


def open_task_folder(folder: Path, task: Mapping[str, Any]) -> Path:
    """The folder with the state of an earlier run of the same task; otherwise an empty folder.

    ``task``: everything that the state depends on, as JSON values.
    """
    text = json.dumps(task, indent=2, sort_keys=True) + "\n"
    file = folder / "task.json"
    if not file.exists() or file.read_bytes() != text.encode():
        shutil.rmtree(folder, ignore_errors=True)
        write_text(file, text)
    return folder
