"""A program in place of the page of `gpf view`, to measure how quickly that responds."""

from __future__ import annotations

import json
import math
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from rich.console import Console
from rich.table import Table
from websockets.sync.client import ClientConnection, connect

import gpf
from benchmarks import cli
from benchmarks.measured_scenes import open_scene
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.rendering.timed_sampling import time_of
from gpf.scene.folders import list_scenes
from gpf.scene.snapshot import snapshot_scene

ROWS, SPP, PASSES = 512, 64, 24

# Seconds of motion before the measurement, and of the measurement; inputs per second.
WARM_UP, MEASURED, INPUTS = 6.0, 8.0, 60

# Seconds of a fit while its memory is measured.
FITTED = 60.0


class Page:
    """Talks to the server as the page does."""

    def __init__(self, link: ClientConnection) -> None:
        self._link, self._number, self._sent = link, 0, dict[int, float]()
        self.camera: dict[str, Any] = {}
        while not self.camera:
            header = self._receive(10)
            if header and header["type"] == "hello":
                start = header["cameras"][0]
                self.camera = {key: start[key] for key in ("origin", "target", "up", "fov")}
        self._start = np.subtract(self.camera["origin"], self.camera["target"])
        self._tell({"type": "look", "rows": ROWS})

    def move(self, seconds: float) -> np.ndarray:
        """Swing around the target; the delay and the rows of each picture that comes back,
        (2, N)."""
        pictures, begin, last = [], time.perf_counter(), 0.0
        while (now := time.perf_counter()) - begin < seconds:
            if now - last > 1 / INPUTS:
                last = now
                self._turn(0.25 * math.sin(2 * (now - begin)))
            header = self._receive(max(0.0, last + 1 / INPUTS - time.perf_counter()))
            if header and header["type"] == "picture" and header["number"] in self._sent:
                delay = time.perf_counter() - self._sent[header["number"]]
                pictures.append((delay, header["height"]))
        return np.reshape(pictures, (-1, 2)).T

    def first(self) -> None:
        """Wait for the first picture."""
        header = None
        while header is None or header["type"] != "picture":
            header = self._receive(120)

    def watch(self, seconds: float) -> None:
        """Receive pictures of a camera at rest."""
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0:
            self._receive(left)

    def rest(self) -> float:
        """Seconds until the picture of a new camera has all its samples."""
        self._turn(0.1)
        begin = time.perf_counter()
        while True:
            header = self._receive(120)
            assert header is not None, "no picture"
            if header["type"] == "picture" and header["number"] == self._number:
                if header["frames"] >= SPP:
                    return time.perf_counter() - begin

    def _turn(self, angle: float) -> None:
        """Move the camera around the vertical axis of the world through its target."""
        up = np.array(self.camera["up"])
        cos, sin = math.cos(angle), math.sin(angle)
        turned = self._start * cos + np.cross(up, self._start) * sin
        turned += up * (up @ self._start) * (1 - cos)
        origin = list(np.add(self.camera["target"], turned))
        message = {"type": "camera", "camera": self.camera | {"origin": origin}}
        self._tell(message)

    def _tell(self, message: dict[str, Any]) -> None:
        self._number += 1
        self._sent[self._number] = time.perf_counter()
        self._link.send(json.dumps(message | {"number": self._number}))

    def _receive(self, seconds: float) -> dict[str, Any] | None:
        """The header of the next message, or None if none comes in time."""
        try:
            message = self._link.recv(timeout=seconds)
        except TimeoutError:
            return None
        assert isinstance(message, bytes)
        (length,) = struct.unpack(">I", message[:4])
        header: dict[str, Any] = json.loads(message[4 : 4 + length])
        if header["type"] == "picture":
            self._link.send(json.dumps({"type": "seen", "picture": header["picture"]}))
        return header


@contextmanager
def viewing(folder: Path, *words: str) -> Iterator[tuple[int, Page]]:
    """Run `gpf view` in a folder; yields its process id and a page."""
    command = [sys.executable, "-m", "gpf.cli", "view", *words, "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            origin = address.rpartition("/")[0].rpartition("/")[0]
            socket = address.replace("http", "ws", 1) + "socket"
            with connect(socket, origin=origin, max_size=None) as link:  # type: ignore[call-overload]
                yield process.pid, Page(link)
        finally:
            process.terminate()


def resources(process: int) -> tuple[int, float]:
    """Bytes and CPU seconds that a process and its descendants use; shared bytes count once."""
    first = psutil.Process(process)
    every = [first, *first.children(recursive=True)]
    size = sum(each.memory_full_info().pss for each in every)
    return size, sum(sum(each.cpu_times()[:2]) for each in every)


def viewer(scenes: cli.ProjectScenes = None) -> None:
    """How quickly `gpf view` responds to a camera that moves 60 times a second.

    One line per scene: pictures per second and their rows, the time from an input to its picture
    (median, 95th percentile), and the time for a still of 512 rows with 64 samples per pixel, also
    relative to `gpf render`. Then, without a field, while one is fitted: the time from the address
    to the first picture; and, for a minute in which the camera alternately moves for a second and
    rests for four, the largest memory of the viewer and the fit together, sampled after each rest,
    and the number of cores that they kept busy.
    """
    moving = "pictures/s", "rows", "median ms", "95 % ms"
    table = Table("scene", *moving, "still s", "× gpf render", "first s", "GB", "cores")
    for name in scenes or list_scenes():
        with tempfile.TemporaryDirectory() as folder:
            table.add_row(name, *measure(name, Path(folder)))
        Console(width=120).print(table)


def measure(name: str, folder: Path) -> list[str]:
    """The cells of a scene."""
    snapshot_scene(name, folder / name)
    scene_file, field_file = folder / name / "scene.xml", folder / "field.safetensors"
    measured = open_scene(name)
    views = measured.training_views
    field = measured.fit(views, passes=PASSES)
    gpf.save_field(field, field_file)
    renderer = FieldRenderer.make(measured.scene, field, RenderSettings(spp=SPP))
    alone = time_of(lambda: renderer.render(views[0], measured.size(ROWS), seed=0))
    with viewing(folder, str(scene_file), "--field", str(field_file)) as (_, page):
        page.move(WARM_UP)
        delays, heights = page.move(MEASURED)
        page.rest()
        still = page.rest()
    field_file.unlink()
    with viewing(folder, str(scene_file)) as (process, page):
        start = time.perf_counter()
        page.first()
        first = time.perf_counter() - start
        sizes, (_, before), start = [0], resources(process), time.perf_counter()
        while time.perf_counter() - start < FITTED:  # while the camera moves, the fit pauses
            page.move(1)
            page.watch(4)
            sizes.append(resources(process)[0])
        cores = (resources(process)[1] - before) / (time.perf_counter() - start)
    return [
        f"{len(delays) / MEASURED:.0f}",
        f"{np.median(heights):.0f}",
        *(f"{1e3 * delay:.0f}" for delay in np.quantile(delays, (0.5, 0.95))),
        f"{still:.1f}",
        f"{still / alone:.1f}",
        f"{first:.1f}",
        f"{max(sizes) / 1e9:.1f}",
        f"{cores:.1f}",
    ]
