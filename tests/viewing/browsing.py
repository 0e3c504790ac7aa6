"""`gpf view` in a folder, and what is done to its page in headless Chromium."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.browser import look, needs_browser

MARKS = [pytest.mark.slow, needs_browser]

BOX = Path(__file__).parents[2] / "scenes" / "cornell_box" / "scene.xml"


@contextmanager
def viewing(folder, *words, scene=BOX):
    """`gpf view` in a folder, and the address that it prints."""
    command = [sys.executable, "-m", "gpf.cli", "view", str(scene), "--no-open", *words]
    with (folder / "log.txt").open("w") as log:
        process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=log, text=True
        )
        try:
            address = process.stdout.readline().strip()
            assert address, (folder / "log.txt").read_text()
            yield process, address
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
            process.stdout.close()


def picture(page) -> np.ndarray:
    """The middle of the window, (H, W, 3)."""
    return look(page, 400, 200, 500, 500).astype(float)


def drag(page, way=120, button="left"):
    page.mouse.move(650, 450)
    page.mouse.down(button=button)
    for k in range(12):
        page.mouse.move(650 + way * k / 11, 450)
        time.sleep(0.02)
    page.mouse.up(button=button)
