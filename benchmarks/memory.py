"""`python -m benchmarks.memory [SIZE]`: the peak memory of `sppm` for a film of SIZE² pixels."""

from __future__ import annotations

import sys

import drjit as dr
import mitsuba as mi

from benchmarks.glass_sphere import PHOTONS, load_scene
from gpf.core.runtime import choose_variant
from stages.common.costs import peak_memory


def main() -> None:
    """Render three passes; print the peak memory after and before rendering."""
    choose_variant("auto")
    size = int(sys.argv[1]) if len(sys.argv) > 1 else 1024
    scene = load_scene(size, size)
    before = peak_memory()
    sppm = {"type": "sppm", "photons_per_pass": PHOTONS, "initial_radius": 0.02}
    dr.eval(mi.render(scene, integrator=mi.load_dict(sppm), spp=3))
    dr.sync_thread()
    print(
        f"{size}², {PHOTONS} paths per pass: {peak_memory() / 1e9:.2f} GB, "
        f"{before / 1e9:.2f} GB before rendering"
    )


if __name__ == "__main__":
    main()
