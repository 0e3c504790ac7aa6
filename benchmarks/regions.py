"""`python -m benchmarks.regions SCENE …`: the field's error by region, after the stage `metrics`.

Every pixel of every novel view belongs to the first region whose condition it meets:

- glass: most camera rays of the pixel are refracted or reflected before they end;
- edge: rays of the pixel end on different surfaces;
- unseen: no training view has a point within two search radii of the visible point;
- caustic: light changes by more than a fifth over two pixels;
- rest.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import mitsuba as mi
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.ndimage import median_filter
from scipy.spatial import cKDTree

from gpf.camera.film import sample_film
from gpf.core.images import read_exr, tone_map
from gpf.core.structs import to_numpy
from gpf.field.io import read_field
from gpf.training.targets import Targets
from report.figures.places import arriving_light
from stages.common.workspace import Workspace

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
        table = Table("region", "pixels", *(f"{m}: dB (error share)" for m in errors), title=name)
        for number, region in enumerate((*REGIONS, "all")):
            chosen = (regions == number) | (region == "all")
            cells = [_cell(error, chosen) for error in errors.values()]
            table.add_row(region, f"{chosen.mean():.1%}", *cells)
        console.print(table)


def view_errors(work: Workspace) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """For each novel view: the regions of its pixels, (H W,), and their squared errors by method,
    (H W,) each."""
    scene, field = work.load_scene(), read_field(work.field)
    seen = cKDTree(Targets.load(work.targets).select("views").position)
    exposure = work.views.exposure
    for view in work.views.novel:
        layers, snapshots = (
            read_exr(file(view.name))[0] for file in (work.reference, work.second_reference)
        )
        passes = max(int(name.removeprefix("sppm_")) for name in snapshots)
        images = {
            "GPF": read_exr(work.render("gpf", view.name))[0]["radiance"],
            f"SPPM, {passes} passes": snapshots[f"sppm_{passes}"],
        }
        truth = tone_map(layers["radiance"], exposure)
        errors = {
            name: ((tone_map(image, exposure) - truth) ** 2).mean(axis=2).ravel()
            for name, image in images.items()
        }
        far = 2 * field.settings.search_radius
        unseen = seen.query(layers["position"].reshape(-1, 3))[0] > far
        yield find_regions(scene, work.sensor(view), layers, unseen), errors


def _cell(error: np.ndarray, chosen: np.ndarray) -> str:
    if not chosen.any():
        return ""
    level = -10 * np.log10(error[chosen].mean())
    return f"{level:.1f} ({error[chosen].sum() / error.sum():.0%})"


def find_regions(
    scene: mi.Scene,
    sensor: mi.Sensor,
    layers: dict[str, np.ndarray],
    unseen: np.ndarray | bool = False,
) -> np.ndarray:
    """The number of each pixel's region, (H W,).

    Parameters
    ----------
    layers: layers of the view's reference.
    unseen: pixels whose visible point is not near any point of a training view, (H W,).
    """
    films = [sample_film(scene, sensor, seed) for seed in range(RAYS)]
    points = [film.points for film in films]
    valid = np.stack([to_numpy(p.valid) for p in points])
    through = np.mean([to_numpy(p.depth) > 0 for p in points], axis=0) > 0.5
    normals = np.stack([to_numpy(p.n) for p in points])
    positions = np.stack([to_numpy(p.p) for p in points])
    # Points on one plane have offsets perpendicular to the normal, at any viewing angle.
    offset = positions - positions[0]
    off_plane = np.abs((offset * normals[0]).sum(axis=2)).max(axis=0)
    along = np.linalg.norm(offset, axis=2).max(axis=0)
    turned = ((normals * normals[0]).sum(axis=2).min(axis=0) < 0.9) & valid.any(axis=0)
    edge = turned | (off_plane > 0.2 * along + 1e-6) | (valid != valid[0]).any(axis=0)
    lit = layers["valid"].ravel() > 0.5
    unseen = lit & unseen
    level = arriving_light(layers["radiance"], layers["reflectance"]).mean(axis=2)
    around = median_filter(level, 5)
    steep = (np.abs(level - around) > CHANGE * np.maximum(around, 1e-6)).ravel() & lit
    region = np.full(lit.size, REGIONS.index("rest"))
    for name, mask in (
        ("caustic", steep),
        ("unseen", unseen),
        ("edge", edge),
        ("glass", through),
    ):
        region[mask] = REGIONS.index(name)
    return region


if __name__ == "__main__":
    main()
