"""Short descriptions of all systems."""

from __future__ import annotations

import inspect
from dataclasses import dataclass

from report.results import FIELD, SECOND_REFERENCE, Results

ABOUT = {
    FIELD: "The method of this project. Photons become Gaussians, which are fitted once to the "
    "result of many SPPM passes on the scene's surfaces. A camera path looks the Gaussians up at "
    "its first diffuse surface.",
    SECOND_REFERENCE: "The second reference: SPPM with as many passes as the reference but other "
    "random numbers. It shows how well two references agree, and is not ranked.",
    "path_tracer": "Mitsuba's path tracer: paths from the camera that connect to the lamps. Light "
    "through glass or water is found only by chance.",
    "particle_tracer": "Mitsuba's particle tracer: paths from the lamps that connect to the "
    "camera. What the camera sees in a mirror or through glass is missing.",
    "sppm": "Stochastic progressive photon mapping with few passes: camera paths collect photons "
    "within a radius that shrinks from pass to pass.",
    "denoised": "The path tracer, denoised by a network (Open Image Denoise).",
    "cycles": "Blender's path tracer, with path guiding, shadow caustics and Open Image Denoise.",
    "luxcore": "LuxCoreRender's path tracer, with light tracing, PhotonGI and Open Image Denoise.",
    "em_gmm": "A mixture of Gaussians, fitted to the density of photons by expectation "
    "maximisation (Jakob, Regg and Jarosz 2011).",
    "radiance_cache": "The training targets and the camera walk of the field, with a hash grid and "
    "a small network instead of Gaussians.",
    "instant_ngp": "A radiance volume of hash grids and small networks, fitted to images (Müller "
    "et al. 2022).",
    "splatting": "Gaussians, fitted to images and drawn as splats (Kerbl et al. 2023).",
    "renderformer": "A transformer that was trained to render triangle meshes (Zeng et al. 2025); "
    "nothing is fitted to the scene.",
    "anysplat": "A network that predicts splats from a few images (Jiang et al. 2025).",
}
"""Description by system; also of the two methods without a row in ``baselines``."""


@dataclass(frozen=True)
class Entry:
    """A system.

    Attributes
    ----------
    titles: titles of its methods.
    missing: reason -> titles of the scenes without numbers.
    """

    titles: list[str]
    about: str
    missing: dict[str, list[str]]


def list_systems(results: Results) -> list[Entry]:
    """All systems, the field first; methods with different ``missing`` have separate entries."""
    entries: dict[str, Entry] = {}
    names = sorted(results.methods, key=lambda name: name != FIELD)
    for name in names:
        system = (
            name if name in (FIELD, SECOND_REFERENCE) else results.params.baselines[name].system
        )
        missing = _missing(results, name)
        entry = entries.setdefault(f"{system} {missing}", Entry([], _about(results, name), missing))
        entry.titles.append(results.methods[name])
    return list(entries.values())


def _missing(results: Results, method: str) -> dict[str, list[str]]:
    missing: dict[str, list[str]] = {}
    for scene in map(results.scene, results.scenes):
        if reason := results.reasons(scene.name, method).get(""):
            missing.setdefault(reason, []).append(scene.title)
    return missing


def _about(results: Results, method: str) -> str:
    """The description of a method's system; for an unknown system the docstring of its options."""
    if method in (FIELD, SECOND_REFERENCE):
        return ABOUT[method]
    options = results.params.baselines[method]
    first = (inspect.getdoc(type(options)) or "").partition("\n")[0]
    return ABOUT.get(options.system, first.replace("``", ""))
