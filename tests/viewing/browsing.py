"""`gpf view` in a folder, and what is done to its page in headless Chromium."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.browser import find_browser

PROGRAM = find_browser()
MARKS = [
    pytest.mark.slow,
    pytest.mark.skipif(PROGRAM is None, reason="no Chromium on the path"),
]

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
    return page.look(400, 200, 500, 500).astype(float)


def drag(page, way=120, button="left"):
    page.point(650, 450, "mousePressed", button=button, buttons=1, clickCount=1)
    for k in range(12):
        page.point(650 + way * k / 11, 450, "mouseMoved", button=button, buttons=1)
        time.sleep(0.02)
    page.point(650 + way, 450, "mouseReleased", button=button)
