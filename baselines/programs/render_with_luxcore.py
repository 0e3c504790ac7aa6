"""Render scene files of LuxCore; run by :mod:`baselines.luxcore.baseline`.

The first request names the ``scene`` and the ``config`` (properties). A further one has a
``camera``, the ``seconds`` or ``samples`` to spend, a ``seed``, more properties as ``config``, and
the output file ``image``.
"""

from __future__ import annotations

import array
import importlib
import struct
import time
from collections.abc import Callable
from typing import Any

from conversation import (  # type: ignore[import-not-found]  # in the folder of this script
    Refusal,
    converse,
    peak_megabytes,
)

Answer = dict[str, Any]


def start(request: Answer) -> tuple[Callable[[Answer], Answer], Answer]:
    """Load the scene."""
    lux = importlib.import_module("pyluxcore")
    lux.Init()
    scene = lux.Scene()
    try:
        scene.Parse(lux.Properties(request["scene"]))
    except RuntimeError as error:
        raise Refusal(f"LuxCore: {error}", "Leave the system out for this scene.") from error

    def respond(more: Answer) -> Answer:
        return render(lux, scene, request["config"], more)

    return respond, {"version": f"LuxCore {lux.Version()}", "device": "cpu"}


def render(lux: Any, scene: Any, config: Answer, request: Answer) -> Answer:
    """Write an image, linear, (H, W, 3) float32."""
    started = time.perf_counter()
    width, height = request["camera"]["size"]
    scene.Parse(make(lux, look(request["camera"])))
    own = {
        "film.width": width,
        "film.height": height,
        "renderengine.seed": request["seed"] % 2**31 + 1,
    }
    own["batch.haltspp"] = [request.get("samples", 0), 0]
    settings = make(lux, {**config, **request["config"], **own})
    session = lux.RenderSession(lux.RenderConfig(settings, scene))
    session.Start()  # which also builds the caches
    end = time.perf_counter() + request.get("seconds", float("inf"))
    while not session.HasDone() and time.perf_counter() < end:
        time.sleep(0.02)
        session.UpdateStats()
    session.Stop()
    film = session.GetFilm()
    pixels = array.array("f", bytes(4 * 3 * width * height))
    film.GetOutputFloat(lux.FilmOutputType.RGB_IMAGEPIPELINE, pixels, 0, True)
    write_npy(request["image"], pixels, (height, width, 3))
    samples = session.GetStats().Get("stats.renderengine.pass").GetInt()
    seconds = time.perf_counter() - started
    return {"seconds": seconds, "spp": samples, "peak_megabytes": peak_megabytes()}


def make(lux: Any, found: Answer) -> Any:
    """Properties from a dictionary."""
    properties = lux.Properties()
    for key, value in found.items():
        properties.Set(lux.Property(key, value))
    return properties


def look(camera: Answer) -> Answer:
    """The camera: its screen is in a distance of 1, and reaches from edge to edge of the image."""
    (width, height), (x, y), focal = camera["size"], camera["centre"], camera["focal"]
    place = camera["origin"]
    ahead, down = ([row[k] for row in camera["rotation"]] for k in (2, 1))
    # LuxCore counts rows from 1.
    window = [-x / focal, (width - x) / focal, (y - height - 1) / focal, (y - 1) / focal]
    return {
        "scene.camera.type": "perspective",
        "scene.camera.lookat.orig": place,
        "scene.camera.lookat.target": [p + d for p, d in zip(place, ahead, strict=True)],
        "scene.camera.up": [-d for d in down],
        "scene.camera.fieldofview": 90.0,
        "scene.camera.screenwindow": window,
        "scene.camera.autofocus.enable": False,
        "scene.camera.cliphither": 1e-3,
        "scene.camera.clipyon": 1e5,
    }


def write_npy(path: str, pixels: array.array[float], shape: tuple[int, int, int]) -> None:
    """Write an array; LuxCore's own environment needs no NumPy. Rows of films begin below."""
    height, width, channels = shape
    row = width * channels
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}"
    header = header.ljust(117) + "\n"
    with open(path, "wb") as file:
        file.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode("latin1"))
        for y in reversed(range(height)):
            file.write(pixels[y * row : (y + 1) * row].tobytes())


if __name__ == "__main__":
    converse(start)
