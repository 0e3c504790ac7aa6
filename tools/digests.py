"""Digests of the pipeline's results: refactoring must not change a single bit.

    python tools/digests.py --write     # before a change: writes tools/digests.json
    python tools/digests.py             # after it: lists what differs; exit code 1

The digests cover references, targets, photons, fields, renders and classical baselines of all
scenes at small sizes, which takes a few minutes. One scene uses all ``auto`` settings, others
switch most options. Each scene runs in a process with one thread, because the order of threads
changes sums of floats: gradients of the training, and the film of Mitsuba's particle tracer. The
bits depend on the processor, LLVM and Mitsuba: write the file again on another machine.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import sys
import tempfile
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from ruamel.yaml import YAML
from safetensors.numpy import load_file

PROJECT = Path(__file__).resolve().parents[1]
FILE = PROJECT / "tools" / "digests.json"

SIZES: Mapping[str, Any] = {
    "film.height": 24,
    "reference.passes": 6,
    "reference.photons_per_pass": 8000,
    "reference.glossy_walks": 8,
    "reference.view_points": 2000,
    "reference.surface_points": 1500,
    "progress.preview_seconds": 0,
    "photons.paths": 6000,
    "field.gaussians": 1500,
    "train.steps": 30,
    "train.batch": 512,
    "train.rebuild_every": 10,
    "train.evaluate_every": 10,
    "stream.passes": 12,
    "stream.view_points": 2000,
    "stream.surface_points": 1500,
    "render.spp": 16,
}
VISIBLE_REGION = {"rays": 20_000, "pilot_paths": 40_000}

# Different settings for single scenes; together they cover most options.
OTHERWISE: Mapping[str, Mapping[str, Any]] = {
    "cornell_box": {
        "reference.photons_per_pass": "auto",
        "photons.paths": "auto",
        "field.gaussians": "auto",
    },
    "veach_bidir": {
        "field.direct": "emitters",
        "field.stores": "radiance",
        "field.initial_colour": "density",
        "render.adaptive": False,
    },
    "water_caustic": {"train.supervision": "streaming", "field.gaussians": "auto"},
    "water_caustic_2": {"reference.direct": "photons", "field.precision": "compact"},
}
METHODS = ("path_10", "particle_64", "sppm_3", "denoised_50", "em_gmm")
WITH_METHODS = ("cornell_box", "veach_ajar")
STAGES = ("scene", "reference", "photons", "train", "render")


def run_stages(folder: Path, scene: str) -> None:
    """Run the stages of a scene in its own folder, in this process."""
    sys.path.insert(0, str(PROJECT))
    from gpf.cli import main
    from gpf.core.yaml import load_yaml

    drjit = importlib.import_module("drjit")  # after gpf, which finds libLLVM
    drjit.set_thread_count(1)
    yaml, params = YAML(), PROJECT / "params.yaml"
    document = load_yaml(params.read_text(encoding="utf-8"), str(params), yaml)
    values = {**SIZES, **{f"visible_region.{k}": v for k, v in VISIBLE_REGION.items()}}
    for key, value in {**values, **OTHERWISE.get(scene, {})}.items():
        name, _, leaf = key.partition(".")
        document.setdefault(name, {})[leaf] = value
    folder.mkdir()
    (folder / "scenes").symlink_to(PROJECT / "scenes")
    with (folder / "params.yaml").open("w", encoding="utf-8") as file:
        yaml.dump(document, file)
    os.chdir(folder)
    calls = [["stage", stage, "--scene", scene] for stage in STAGES]
    if scene in WITH_METHODS:
        calls += [["stage", "baseline", "--scene", scene, "--method", m] for m in METHODS]
    for call in calls:
        try:
            main(call)
        except SystemExit as end:
            if end.code:
                raise


def digest_arrays(folder: Path) -> dict[str, str]:
    """File and layer -> digest of the values; metadata is ignored."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".safetensors":
            arrays = load_file(path)
        elif path.suffix == ".exr":
            with OpenEXR.File(str(path), separate_channels=True) as file:
                arrays = {layer: c.pixels.copy() for layer, c in file.channels().items()}
        else:
            continue
        for layer, array in sorted(arrays.items()):
            data = np.ascontiguousarray(array)
            text = f"{data.dtype} {data.shape} ".encode() + data.tobytes()
            found[f"{name}: {layer}"] = hashlib.sha256(text).hexdigest()[:16]
    return found


def digest_scene(scene: str) -> dict[str, str]:
    """Digests of all results of a scene."""
    with tempfile.TemporaryDirectory(prefix="gpf-digests-") as folder:
        run_stages(Path(folder) / scene, scene)
        return digest_arrays(Path(folder) / scene / "results" / scene)


def main() -> int:
    """Write or compare the digests; 1 if something differs."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--write", action="store_true", help="store the digests")
    parser.add_argument("scenes", nargs="*", help="only these scenes")
    options = parser.parse_args()
    scenes = options.scenes or sorted(p.parent.name for p in PROJECT.glob("scenes/*/views.yaml"))
    known = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    with ProcessPoolExecutor(
        os.cpu_count(), mp_context=get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        results = dict(zip(scenes, pool.map(digest_scene, scenes), strict=True))
    if options.write:
        FILE.write_text(json.dumps(known | results, indent=1, sort_keys=True) + "\n", "utf-8")
        return 0
    differing = 0
    for scene, found in results.items():
        names = sorted({*found, *known.get(scene, {})})
        changed = [n for n in names if found.get(n) != known.get(scene, {}).get(n)]
        print(f"{scene}: {len(names)} arrays, {len(changed)} differ")
        for name in changed:
            print(f"  {name}: {known.get(scene, {}).get(name)} -> {found.get(name)}")
        differing += len(changed)
    return int(differing > 0)


if __name__ == "__main__":
    sys.exit(main())
