"""Pages in headless Chromium, the one of the system, by Playwright."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PROGRAM = next((found for name in NAMES if (found := shutil.which(name))), None)

SOFTWARE_WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")

PATIENCE = 30.0
"""Seconds to wait for something to become true; a busy machine is slow."""

needs_browser = pytest.mark.skipif(
    PROGRAM is None, reason="no Chromium on the path (Debian and Ubuntu: apt install chromium)"
)


@contextmanager
def start_browser() -> Iterator[Browser]:
    """A browser for any number of pages."""
    with sync_playwright() as playwright:
        yield playwright.chromium.launch(
            executable_path=PROGRAM, args=["--disable-dev-shm-usage", *SOFTWARE_WEBGL]
        )


@contextmanager
def open_page(
    browser: Browser,
    place: Path | str,
    width: int = 1400,
    height: int = 900,
    dark: bool = False,
    complains: bool = False,
    scale: float = 1,
) -> Iterator[Page]:
    """Open a file or an address in a window of this size.

    ``scale``: pixels of the screen per pixel of the window, in each direction.

    In the end, the page must have asked for nothing but files of its own server, and unless it
    ``complains``, there must be no error and no warning.
    """
    mobile = width < 600
    context = browser.new_context(
        viewport={"width": width, "height": height},
        color_scheme="dark" if dark else "light",
        is_mobile=mobile,
        has_touch=mobile,
        device_scale_factor=scale,
    )
    page = context.new_page()
    address = place if isinstance(place, str) else place.resolve().as_uri()
    requests: list[str] = []
    complaints: list[str] = []
    page.on("request", lambda request: requests.append(request.url[:80]))
    page.on("websocket", lambda socket: requests.append(socket.url.replace("ws:", "http:")))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on(
        "console",
        lambda said: complaints.append(said.text) if said.type in ("error", "warning") else None,
    )
    try:
        page.goto(address)
        yield page
        own = address if address.startswith("file:") else "/".join(address.split("/")[:3])
        assert requests and all(url.startswith((own[:80], "data:", "blob:")) for url in requests)
        assert complains or complaints == []
    finally:
        context.close()


def wait_for(page: Page, script: str) -> None:
    """Wait until an expression is true. Playwright's own wait needs a page that allows `eval`."""
    end = time.monotonic() + PATIENCE
    while not page.evaluate(script):
        assert time.monotonic() < end, f"never became true: {script}"
        time.sleep(0.02)


def look(page: Page, x: float, y: float, width: float, height: float) -> np.ndarray:
    """A screenshot of a part of the window, (H, W, 3) uint8."""
    data = page.screenshot(clip={"x": x, "y": y, "width": width, "height": height})
    return np.asarray(Image.open(BytesIO(data)).convert("RGB"))
