"""Blender's volume shaders as Mitsuba's homogeneous media.

As in Cycles, with a density d, a colour c and an absorption colour a, coefficients in 1/m:

==================  ==================  ===========================
Volume Scatter      σ_s = c d           σ_a = 0
Volume Absorption   σ_s = 0             σ_a = (1 - c) d
Principled Volume   σ_s = c d           σ_a = (1 - c) (1 - √a) d
==================  ==================  ===========================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gpf.blender.closures import Closure, Dict


@dataclass
class Coefficients:
    """Scattering and absorption, 1/m, (3,) each, and the mean cosine of the scattering.

    Attributes
    ----------
    notes: what is approximated, and how.
    """

    scattering: np.ndarray = field(default_factory=lambda: np.zeros(3))
    absorption: np.ndarray = field(default_factory=lambda: np.zeros(3))
    cosine: float = 0.0
    notes: list[str] = field(default_factory=list)


def make_medium(closure: Closure) -> tuple[Dict | None, list[str]]:
    """A volume as a dictionary for `mi.load_dict`, or None if it has no effect; and notes."""
    found = _coefficients(closure)
    extinction = found.scattering + found.absorption
    greatest = float(extinction.max())
    if not greatest > 0:
        return None, found.notes
    albedo = np.divide(found.scattering, extinction, out=np.zeros(3), where=extinction > 0)
    return {
        "type": "homogeneous",
        "albedo": {"type": "rgb", "value": albedo.tolist()},
        "sigma_t": {"type": "rgb", "value": (extinction / greatest).tolist()},
        "scale": greatest,
        "phase": {"type": "hg", "g": float(np.clip(found.cosine, -0.99, 0.99))},
    }, found.notes


def _coefficients(closure: Closure) -> Coefficients:
    kind = closure["closure"]
    if kind in ("add", "mix"):
        factor = closure.get("factor", 0.5)
        shares = (1 - factor, factor) if kind == "mix" else (1.0, 1.0)
        return _sum([_coefficients(closure[key]) for key in ("first", "second")], shares)
    found = Coefficients()
    if "unknown" in closure:
        found.notes.append(f"{closure['unknown']} as a volume left out")
    if varying := closure.get("varying"):
        found.notes.append(f"{', '.join(varying)} of the volume the same everywhere")
    if kind == "none":
        return found
    colour = np.clip(np.array(closure["color"], dtype=float), 0, 1)
    density = max(float(closure["density"]), 0.0)
    if kind == "volume_absorption":
        found.absorption = density * (1 - colour)
        return found
    found.scattering, found.cosine = density * colour, float(closure["anisotropy"])
    if kind == "volume_principled":
        tint = np.clip(np.array(closure["absorption_color"], dtype=float), 0, 1)
        found.absorption = density * (1 - colour) * (1 - np.sqrt(tint))
        if closure["emission_strength"] or closure["blackbody_intensity"]:
            found.notes.append("emission of the volume left out")
    return found


def _sum(parts: Sequence[Coefficients], shares: Sequence[float]) -> Coefficients:
    """Volumes on top of each other; their phase functions become one, with the mean cosine."""
    total = Coefficients()
    weights = []
    for part, share in zip(parts, shares, strict=True):
        total.scattering = total.scattering + share * part.scattering
        total.absorption = total.absorption + share * part.absorption
        total.notes += part.notes
        weights.append(share * float(part.scattering.mean()))
    if sum(weights) > 0:
        cosines = [part.cosine for part in parts]
        total.cosine = float(np.average(cosines, weights=weights))
        if min(weights) > 0 and cosines[0] != cosines[1]:
            total.notes.append("two phase functions as one, with their mean cosine")
    return total
