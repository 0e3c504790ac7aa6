"""Optional parts of the systems: which ones are installed, and how to install the others."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

from baselines.anysplat.baseline import CODE as ANYSPLAT
from baselines.cycles import HOST as CYCLES
from baselines.luxcore.baseline import HOST as LUXCORE
from baselines.protocol import CannotServe
from baselines.renderformer.baseline import CODE as RENDERFORMER

# Module -> its name, what needs it, and the command that installs it.
PACKAGES = {
    "pyoidn": ("OIDN", "denoised rows", "pip install pyoidn==2.5.1.0"),
    "gsplat": ("gsplat", "splatting rows", "pip install --no-deps gsplat==1.5.3"),
    "h5py": ("h5py", "RenderFormer", "pip install h5py==3.16.0"),
    "fast_simplification": (
        "decimation",
        "RenderFormer",
        "pip install fast-simplification==0.2.0",
    ),
}


@dataclass(frozen=True)
class Part:
    """An optional part of a system. ``remedy`` is the command that installs it."""

    name: str
    there: bool
    detail: str
    remedy: str


def list_parts() -> list[Part]:
    """The optional parts of all systems; does not import them."""
    parts = []
    for module, (name, user, remedy) in PACKAGES.items():
        there = find_spec(module) is not None
        detail = f"for {user}" if there else f"not installed; {user} will say so in the tables"
        parts.append(Part(name, there, detail, remedy))
    for code in (RENDERFORMER, ANYSPLAT):
        try:
            detail = f"{code.find()}, run by {code.find_interpreter()}"
            parts.append(Part(code.name, True, detail, ""))
        except CannotServe as missing:
            detail = f"{missing.told}; its rows will say so in the tables"
            parts.append(Part(code.name, False, detail, code.install))
    for renderer in (CYCLES, LUXCORE):
        try:
            parts.append(Part(renderer.name, True, f"run by {renderer.command()[0]}", ""))
        except CannotServe as missing:
            detail = f"{missing.told}; its rows will say so in the tables"
            parts.append(Part(renderer.name, False, detail, renderer.install))
    return parts
