"""`python -m benchmarks.independent SCENE …`: another judge of which images are nearer the truth.

Needs the results of `dvc repro`. The published tables compare all systems with references from
which some of them have learned, or whose kernels they share. Here, each view is judged by two
further SPPM images, with photons of their own and the kernels of 4000 passes
(:class:`metrics.halves.Halves`). The table goes to results/independent.md, from where
`python docs/publish.py` takes it. The images are kept; a second run takes seconds.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.judged import KERNELS, trace
from gpf.core.files import write_text
from gpf.core.images import read_exr
from gpf.scene.folders import list_scenes
from metrics.halves import Halves
from metrics.image import lpips
from report.results import Results
from stages.common.workspace import Workspace
from stages.config.titles import method_titles

METHODS = ("gpf", "radiance_cache", "second_reference")


def main() -> None:
    """Print the table and write it to a file."""
    parser = argparse.ArgumentParser(description="Field, radiance cache and SPPM by another judge")
    parser.add_argument("--passes", type=int, default=1000, help="passes of each of the two images")
    parser.add_argument("--views", type=int, default=2, help="number of novel views")
    parser.add_argument("--kept", type=Path, default=Path("results/benchmark_references"))
    parser.add_argument("scenes", nargs="*", default=list_scenes())
    arguments = parser.parse_args()
    lines = [
        "| | PSNR ↑ | relMSE ↓ | LPIPS ↓, judge of 1000 passes | of 2000 | of 4000 |",
        "|---|---|---|---|---|---|",
    ]
    for name in arguments.scenes:
        work = Workspace.open(name)
        halves = judge(work, arguments.views, arguments.passes, arguments.kept)
        lines.append(f"| **{Results.open().scene(name).title}** | | | | | |")
        lines += [row(work, method, halves) for method in METHODS]
        print(*lines[-4:], sep="\n", flush=True)
    write_text(Path("results/independent.md"), "\n".join(["# Another judge", "", *lines, ""]))


def judge(work: Workspace, views: int, passes: int, kept: Path) -> dict[str, Halves]:
    """Two images of each of the first novel views."""
    chosen = work.novel_views()[:views]
    file = kept / f"{work.scene}_independent_{work.film_size[1]}_{views}_{passes}.npz"
    if not file.exists():
        sensors = [work.sensor(view) for view in chosen]
        images, _ = trace(work.scene, work.load_scene(), sensors, passes, KERNELS["long"])
        kept.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(file, images=images)
    with np.load(file) as stored:
        return {v.name: Halves(*i) for v, i in zip(chosen, stored["images"], strict=True)}


def row(work: Workspace, method: str, halves: dict[str, Halves]) -> str:
    """A line of the table: means over the views.

    A judge's noise affects LPIPS, so there are judges with less and less: one image, the mean of
    both, and the mean of both, the reference and the second reference.
    """
    exposure, epsilon = work.views.exposure, work.params.metrics.relmse_epsilon
    numbers = []
    for view, pair in halves.items():
        image, level = shown(work, method, view), read_exr(work.reference(view))[0]["radiance"]
        images = [pair.first, pair.second, level, shown(work, "second_reference", view)]
        judges = [np.mean(images[:count], axis=0) for count in (1, 2, 4)]
        apart = [lpips(image, judged, exposure) for judged in judges]
        numbers.append((pair.psnr(image, exposure), pair.relmse(image, level, epsilon), *apart))
    psnr, relmse, *apart = np.mean(numbers, axis=0)
    title = method_titles(work.params)[method]
    cells = [f"{value:.3f}" for value in apart]
    if method == "second_reference":
        cells[-1] = "–"  # it is one of the judge's images
    return f"| {title} | {psnr:.2f} | {relmse:.5f} | {' | '.join(cells)} |"


def shown(work: Workspace, method: str, view: str) -> np.ndarray:
    """A method's image of a view, (H, W, 3)."""
    if method == "second_reference":
        return read_exr(work.second_reference(view))[0][f"sppm_{work.params.reference.passes}"]
    return read_exr(work.render(method, view))[0]["radiance"]


if __name__ == "__main__":
    main()
