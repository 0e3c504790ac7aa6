"""LuxCore with its photon caches and light tracing.

The settings are those of BlendLuxCore's presets and of its *Render Settings Helper*. For caustics:
light paths beside camera paths, PhotonGI's cache of caustics with a radius that stays, because they
are seen through glass, and no cache of indirect light. For other rooms: PhotonGI's cache of
indirect light. For both: an adaptive Sobol sampler and Open Image Denoise.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np

from baselines.luxcore.properties import Properties
from baselines.luxcore.scene import write_scene
from baselines.official import Program
from baselines.options import LuxcoreOptions
from baselines.peer import PreparedPeer, seconds_for, write_description
from baselines.protocol import CannotServe, Task
from gpf.core.files import read_json

PACKAGE = "pyluxcore==2.11.2"
VARIABLE = "GPF_LUXCORE"

RADIUS = 0.005
"""The caustic cache's radius, by the diagonal of the scene."""


class Luxcore:
    """LuxCore with its options."""

    def __init__(self, options: LuxcoreOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedPeer:
        """Translate the scene, load it, and measure what a view takes apart from its samples.

        Raises
        ------
        CannotServe: the scene has something that is not translated, LuxCore is missing, or a view
            takes too long.
        """
        seconds = seconds_for(self.options.seconds, task)
        folder = write_description(task)
        description = read_json(folder / "scene.json")
        scene = write_scene(description, folder, str(task.file))
        HOST.command()
        bounds = task.scene.bbox()
        size = float(np.linalg.norm(np.array(bounds.max) - np.array(bounds.min)))
        caches = self.options.caches
        if caches == "auto":
            caches = "caustics" if has_caustics(description) else "indirect"
        config = configure(caches, RADIUS * size, self.options.denoise)
        settings = {"scene": str(scene), "config": config}
        program = Program(HOST, "render_with_luxcore.py", settings, task.state.absolute())
        prepared = PreparedPeer(task, program, seconds, choices(caches))
        prepared.measure()
        return prepared


class LuxcoreHost:
    """A Python with the package `pyluxcore`: the one that ``GPF_LUXCORE`` names, or this one."""

    name = "luxcore"
    # Without its dependency, a compiler for CUDA of 210 MB: it renders on the CPU.
    install = f"pip install --no-deps {PACKAGE}"

    def command(self) -> list[str]:
        """The command that runs a script.

        Raises
        ------
        CannotServe: there is no such Python.
        """
        if named := os.environ.get(VARIABLE):
            if found := shutil.which(named):
                return [found]
            reason = f"package not installed: {VARIABLE}={named} is not a program"
            raise CannotServe(self.name, reason, "Name a Python with pyluxcore.")
        if find_spec("pyluxcore") is not None:
            return [sys.executable]
        todo = f"Run `{self.install}` (180 MB), or set {VARIABLE} to a Python with it."
        raise CannotServe(self.name, "package not installed: pyluxcore", todo)

    def settings(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def advice(self) -> str:
        """What to do if a script ends."""
        return f"{self.command()[0]} ran it. If the package is missing there: {self.install}"


HOST = LuxcoreHost()


def has_caustics(description: Mapping[str, Any]) -> bool:
    """Whether a material reflects or refracts in single directions."""

    def is_sharp(material: Mapping[str, Any]) -> bool:
        inner = [
            value for value in material.values() if isinstance(value, dict) and "kind" in value
        ]
        sharp = material["kind"] in ("conductor", "dielectric", "thin")
        return (sharp and material.get("alpha", [0.0])[0] == 0) or any(map(is_sharp, inner))

    return any(map(is_sharp, description["materials"]))


def configure(caches: str, radius: float, denoise: bool) -> Properties:
    """The renderer's properties, apart from those of a view; ``radius`` of cached caustics."""
    caustics, indirect = caches in ("caustics", "both"), caches in ("indirect", "both")
    found: Properties = {
        "renderengine.type": "PATHCPU",
        "sampler.type": "SOBOL",
        "sampler.sobol.adaptive.strength": 0.9,
        "film.noiseestimation.warmup": 8,
        "film.noiseestimation.step": 32,
        "film.filter.type": "NONE",
        "path.hybridbackforward.enable": caustics,
        "path.hybridbackforward.partition": 0.8,
        "path.hybridbackforward.glossinessthreshold": GLOSSINESS,
        "path.photongi.photon.maxdepth": 8,
        "path.photongi.glossinessusagethreshold": GLOSSINESS,
        "path.photongi.indirect.enabled": indirect,
        "path.photongi.indirect.haltthreshold": 0.05,
        "path.photongi.caustic.enabled": caustics,
        "path.photongi.caustic.maxsize": 100_000,
        "path.photongi.caustic.updatespp": 8,
        "path.photongi.caustic.updatespp.minradius": radius,
        "path.photongi.caustic.lookup.radius": radius,
        "film.imagepipelines.0.0.type": "NOP",
    }
    found |= {f"path.pathdepth.{kind}": DEEPEST for kind in DEPTHS}
    if denoise:
        found |= {
            "film.imagepipelines.0.1.type": "INTEL_OIDN",
            "film.imagepipelines.0.1.prefilter.enable": True,
            "film.imagepipelines.0.1.sharpness": 0.0,
        }
    return found


DEPTHS = ("total", "diffuse", "glossy", "specular")
DEEPEST = 128
GLOSSINESS = 0.049


def choices(caches: str) -> tuple[dict[str, Any], ...]:
    """Further properties of a request, from the best to the fastest."""
    prefix = "path.photongi"
    nothing = {f"{prefix}.{kind}.enabled": False for kind in ("indirect", "caustic")}
    raw = {"film.imagepipelines.0.1.type": "NOP"}
    without: dict[str, Any] = {"caches": "none", "config": nothing}
    if caches == "none":
        return (without, without | {"config": nothing | raw})
    # The first is BlendLuxCore's number.
    many, few = ({f"{prefix}.photon.maxcount": count * 1_000_000} for count in (20, 2))
    return (
        {"caches": f"{caches}, 20 million photons", "config": many},
        {"caches": f"{caches}, 2 million photons", "config": few},
        {"caches": f"{caches}, 2 million photons, no denoiser", "config": few | raw},
        without,
    )
