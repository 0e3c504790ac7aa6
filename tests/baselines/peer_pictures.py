"""Pictures by another renderer against Mitsuba's path tracer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from baselines.official import Host
from baselines.peer import PreparedPeer
from baselines.protocol import CannotServe, Task
from baselines.translation.description import describe
from baselines.translation.nodes import read_dict
from gpf.core.images import tone_map
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.baselines.peer_scenes import SIZE, VIEW
from tests.furnace import Scene

# Without its shortcuts: makes a renderer for a description, in a folder for its files.
Start = Callable[[Task, Path], PreparedPeer]


def is_there(host: Host) -> bool:
    """Whether a renderer is installed."""
    try:
        return bool(host.command())
    except CannotServe:
        return False


def compare(
    start: Start, scene: Scene, folder: Path, samples: int, view: View = VIEW
) -> tuple[float, float]:
    """The other renderer's energy by Mitsuba's, and the PSNR without the noise of either, dB."""
    loaded = mi.load_dict(scene, optimize=False)
    describe(read_dict(scene), loaded, folder / "scene", "scene")
    task = Task("test", loaded, folder / "scene.xml", SIZE, 1.0, (), 5, 1, folder)
    peer = start(task, folder / "scene")
    theirs = [picture_by(peer, view, samples, seed) for seed in (1, 2)]
    # Only `volpath` sees lamps through surfaces with an opacity.
    integrator = mi.load_dict({"type": "volpath", "max_depth": 128, "rr_depth": 16})
    sensor = make_sensor(view, *SIZE)
    ours = [
        mi.render(loaded, integrator=integrator, sensor=sensor, spp=samples, seed=seed).numpy()
        for seed in (1, 2)
    ]
    exposure = 0.5 / float(np.median(ours))
    f, g, a, b = (tone_map(image, exposure) for image in (*ours, *theirs))
    # An estimate without bias: below zero where the two differ by their noise alone.
    error = float(((f - a) * (g - b)).mean())
    return float(np.mean(theirs) / np.mean(ours)), -10 * float(np.log10(max(error, 1e-7)))


def picture_by(peer: PreparedPeer, view: View, samples: int, seed: int) -> Any:
    """A picture of so many samples per pixel."""
    image = np.load(peer.ask(view, seed, {"samples": samples})["image"])
    return image.astype(np.float64)
