"""What each system is, for somebody who knows none of them."""

from __future__ import annotations

import inspect
from dataclasses import dataclass

from report.results import FIELD, SECOND_REFERENCE, Results

ABOUT = {
    FIELD: "The method of this project. Photons become Gaussians, which are fitted once to what "
    "many passes of SPPM give on the scene's surfaces. A camera path looks them up where it first "
    "meets something diffuse.",
    SECOND_REFERENCE: "A second reference: as many passes as the first has, but photons of its own. It "
    "tells how close two references come to each other, and does not compete.",
    "path_tracer": "Mitsuba's path tracer: every camera path looks for the lamps by itself. "
    "Light that comes through glass or water is found by luck.",
    "particle_tracer": "Mitsuba's particle tracer: paths from the lamps, each joined with the "
    "camera. What the camera sees in a mirror or through glass is missing.",
    "sppm": "Stochastic progressive photon mapping with few passes: a camera path meets photons "
    "that lamps have sent, in a radius that shrinks from pass to pass.",
    "denoised": "The path tracer, its noise taken out by a network (Open Image Denoise).",
    "em_gmm": "Photons summed up by a mixture of Gaussians that expectation maximisation fits to "
    "their density (Jakob, Regg and Jarosz 2011).",
    "radiance_cache": "The field's own supervision and camera walk, with a hash grid and a small "
    "network in place of the Gaussians.",
    "instant_ngp": "A radiance volume of hash grids and small networks, fitted to pictures "
    "(Müller and others 2022).",
    "splatting": "Gaussians fitted to pictures and drawn as splats (Kerbl and others 2023).",
    "renderformer": "A transformer that was trained to render triangle meshes (Zeng and others "
    "2025); nothing is fitted to the scene.",
    "anysplat": "A network that makes splats from a few pictures at once (Jiang and others 2025).",
}
"""By system, and the two methods that are no rows of ``baselines``."""


@dataclass(frozen=True)
class Entry:
    """A system and its settings; ``missing``: reason -> titles of scenes without numbers."""

    titles: list[str]
    about: str
    missing: dict[str, list[str]]


def list_systems(results: Results) -> list[Entry]:
    """All systems, the field first; settings that miss the same stand together."""
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
    """The words above; of a system that they do not know, what its options say of it."""
    if method in (FIELD, SECOND_REFERENCE):
        return ABOUT[method]
    options = results.params.baselines[method]
    first = (inspect.getdoc(type(options)) or "").partition("\n")[0]
    return ABOUT.get(options.system, first.replace("``", ""))
