"""`python -m benchmarks.regions SCENE …`: where the field's error sits, after the stage `metrics`.

Every pixel of every novel view belongs to the first of these regions that it fits:

- glass: most camera rays of the pixel are refracted or reflected before they end;
- edge: rays of one pixel end on different surfaces;
- unseen: no training view has a point within two search radii of what the pixel shows;
- caustic: light changes by more than a fifth over two pixels;
- rest.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import gpf  # noqa: F401  (first: it tells Dr.Jit where libLLVM is)
from gpf.core.runtime import choose_variant

choose_variant("auto")

import numpy as np  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402
from scipy.ndimage import median_filter  # noqa: E402
from scipy.spatial import cKDTree  # noqa: E402

from gpf.camera.film import sample_film  # noqa: E402
from gpf.core.images import read_exr, tone_map  # noqa: E402
from gpf.core.structs import to_numpy  # noqa: E402
from gpf.field.io import read_field  # noqa: E402
from gpf.scene.views import View  # noqa: E402
from gpf.training.targets import SURFACE, Targets  # noqa: E402
from report.figures.places import arriving_light  # noqa: E402
from stages.common.workspace import Workspace  # noqa: E402

REGIONS = ("glass", "edge", "unseen", "caustic", "rest")
RAYS = 16
CHANGE = 0.2


def main() -> None:
    """Print one table per scene."""
    console = Console(width=120)
    for name in sys.argv[1:]:
        work = Workspace.open(name)
        rows = list(view_errors(work))
        regions = np.concatenate([region for region, _ in rows])
        errors = {
            method: np.concatenate([each[method] for _, each in rows]) for method in rows[0][1]
        }
        table = Table("region", "pixels", *(f"{m}: dB (of the error)" for m in errors), title=name)
        for number, region in enumerate((*REGIONS, "all")):
            chosen = (regions == number) | (region == "all")
            cells = [_cell(error, chosen) for error in errors.values()]
            table.add_row(region, f"{chosen.mean():.1%}", *cells)
        console.print(table)


def view_errors(work: Workspace) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """For each novel view the pixels' regions, (H W,), and squared errors by method, (H W,)."""
    scene, field = work.load_scene(), read_field(work.field)
    targets = Targets.load(work.targets)
    seen = cKDTree(targets.position[targets.source != SURFACE])
    exposure = work.views.exposure
    for view in work.views.novel:
        layers = read_exr(work.reference(view.name))[0]
        layers = read_exr(work.second_reference(view.name))[0]
        last = max(layers, key=lambda name: int(name.split("_")[1]))
        images = {
            "GPF": read_exr(work.render("gpf", view.name))[0]["radiance"],
            f"SPPM, {last.split('_')[1]} passes": layers[last],
        }
        truth = tone_map(layers["radiance"], exposure)
        errors = {
            name: ((tone_map(image, exposure) - truth) ** 2).mean(axis=2).ravel()
            for name, image in images.items()
        }
        yield find_regions(work, scene, view, layers, seen, field.settings.search_radius), errors


def _cell(error: np.ndarray, chosen: np.ndarray) -> str:
    if not chosen.any():
        return ""
    level = -10 * np.log10(error[chosen].mean())
    return f"{level:.1f} ({error[chosen].sum() / error.sum():.0%})"


def find_regions(
    work: Workspace,
    scene: object,
    view: View,
    layers: dict[str, np.ndarray],
    seen: cKDTree,
    r: float,
) -> np.ndarray:
    """The number of the region of every pixel of a view, (H W,)."""
    films = [sample_film(scene, work.sensor(view), seed) for seed in range(RAYS)]
    points = [film.points for film in films]
    valid = np.stack([to_numpy(p.valid) for p in points])
    through = np.mean([to_numpy(p.depth) > 0 for p in points], axis=0) > 0.5
    normals = np.stack([to_numpy(p.n) for p in points])
    positions = np.stack([to_numpy(p.p) for p in points])
    # On one plane, offsets are perpendicular to the normal, whatever the angle of view.
    offset = positions - positions[0]
    off_plane = np.abs((offset * normals[0]).sum(axis=2)).max(axis=0)
    along = np.linalg.norm(offset, axis=2).max(axis=0)
    turned = ((normals * normals[0]).sum(axis=2).min(axis=0) < 0.9) & valid.any(axis=0)
    edge = turned | (off_plane > 0.2 * along + 1e-6) | (valid != valid[0]).any(axis=0)
    place = layers["position"].reshape(-1, 3)
    lit = layers["valid"].ravel() > 0.5
    unseen = lit & (seen.query(place)[0] > 2 * r)
    level = arriving_light(layers["radiance"], layers["reflectance"]).mean(axis=2)
    around = median_filter(level, 5)
    steep = (np.abs(level - around) > CHANGE * np.maximum(around, 1e-6)).ravel() & lit
    region = np.full(len(place), REGIONS.index("rest"))
    for name, mask in (("caustic", steep), ("unseen", unseen), ("edge", edge), ("glass", through)):
        region[mask] = REGIONS.index(name)
    return region


if __name__ == "__main__":
    main()
