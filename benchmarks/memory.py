"""`python -m benchmarks.memory SIZE`: the most memory that `sppm` takes for a film of SIZE²."""

from __future__ import annotations

import resource
import sys

import gpf  # noqa: F401  (first: it tells Dr.Jit where libLLVM is)
from gpf.core.runtime import choose_variant

choose_variant("auto")

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

from benchmarks.glass_sphere import PHOTONS, load_scene  # noqa: E402


def peak() -> float:
    """GB that this process had at most so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def main() -> None:
    """Render three passes, and print what they took on top of the scene."""
    size = int(sys.argv[1]) if len(sys.argv) > 1 else 1024
    scene = load_scene(size, size)
    before = peak()
    sppm = {"type": "sppm", "photons_per_pass": PHOTONS, "initial_radius": 0.02}
    dr.eval(mi.render(scene, integrator=mi.load_dict(sppm), spp=3))
    dr.sync_thread()
    print(f"{size}², {PHOTONS} paths a pass: {peak():.2f} GB, {before:.2f} GB before rendering")


if __name__ == "__main__":
    main()
