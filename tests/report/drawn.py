"""A small folder of results for figures. Images have one colour, so that pixels are known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gpf.core.files import write_json, write_text
from gpf.core.images import tone_map, write_exr
from report.figures.sketch import Sketch, save
from report.results import NUMBERS, Results
from stages.config.params import Params
from tests.report.made_up import seconds

SCENE, OTHER = "water_caustic", "cornell_box"
SIZE = HEIGHT, WIDTH = 32, 48
METHODS: dict[str, dict[str, Any]] = {
    "path_10": {"system": "path_tracer", "spp": 10},
    "path_50": {"system": "path_tracer", "spp": 50},
    "sppm_3": {"system": "sppm", "passes": 3},
    "denoised_50": {"system": "denoised", "spp": 50},
    "em_gmm": {"system": "em_gmm"},
}
LEVELS = {
    "path_10": (0.8, 0.1, 0.1),
    "path_50": (0.7, 0.2, 0.1),
    "sppm_3": (0.1, 0.6, 0.1),
    "denoised_50": (0.1, 0.1, 0.6),
    "gpf": (0.3, 0.3, 0.3),
    "reference": (0.32, 0.32, 0.32),
}
"""Method -> linear radiance of all pixels of its images; the exposure is 1."""

PSNR = {"path_10": 12.0, "path_50": 15.0, "sppm_3": 21.0, "denoised_50": 24.0, "gpf": 37.0}
SECONDS = {"path_10": 1.0, "path_50": 5.0, "sppm_3": 0.4, "denoised_50": 2.5, "gpf": 2.0}
CURVE = {1: 15.0, 3: 21.0, 10: 31.0, 30: 41.0}
CAUSTIC, FAR_OFF = (6, 20), (18, 2)
"""Row and column of the upper left corners of squares of 8 by 8 pixels: in the first, light is
focused; in the second, the field is black."""


def drawn_params(**changes: Any) -> Params:
    """Parameters with three scenes; all methods in all of them."""
    sections: dict[str, Any] = {
        "scenes": [SCENE, OTHER, "veach_ajar"],
        "reference": {"passes": 30},
        "render": {"spp": 16},
        "methods": {"classical": list(METHODS)},
        "baselines": METHODS,
    }
    return Params.model_validate(sections | changes)


def make_drawn(root: Path, **changes: Any) -> Results:
    """Results of two scenes with two views each, one without images; EM-GMM cannot serve them."""
    for scene in (SCENE, OTHER):
        folder = root / scene
        write_text(folder / "views.yaml", _VIEWS)
        for view, worse in (("near", 0.0), ("far", 1.5)) if scene == SCENE else ():
            _write_reference(folder / "reference" / f"{view}.exr")
            for method in PSNR:
                path = folder / "renders" / method / f"{view}.exr"
                write_exr(path, {"radiance": _image(method, worse)}, {})
        for method, psnr in PSNR.items():
            numbers = dict.fromkeys(NUMBERS, 0.5)
            views = {"near": numbers | {"psnr": psnr + 1}, "far": numbers | {"psnr": psnr - 1}}
            report = {"mean": numbers | {"psnr": psnr}, "views": views, "reasons": {}}
            write_json(folder / "metrics" / f"{method}.json", report)
            cost = {
                "facts": {"views": 2},
                "parts": {"render": seconds(2 * SECONDS[method])},
            }
            name = "render" if method == "gpf" else f"baselines/{method}"
            write_json(folder / "costs" / f"{name}.json", cost)
        write_json(folder / "metrics" / "em_gmm.json", {"cannot_serve": "no photons"})
        facts = {"seconds_per_single_view_pass": 0.2}
        write_json(folder / "costs" / "reference.json", {"facts": facts, "parts": {}})
        rows = [{"passes": passes, "psnr": psnr} for passes, psnr in CURVE.items()]
        write_json(folder / "convergence.json", rows)
        write_json(folder / "amortize.json", COST)
        for name, error in (("held_out_error", 0.2), ("training_error", 0.1)):
            lines = [f"step\t{name}", *(f"{step}\t{error * 50 / step}" for step in (50, 100, 150))]
            path = folder / "training" / "plots" / "metrics" / f"{name}.tsv"
            write_text(path, "\n".join(lines) + "\n")
    return Results(drawn_params(**changes), root)


def pixels(sketch: Sketch, folder: Path) -> np.ndarray:
    """The pixels of the figure's file, (H, W, 3), with the lowest row first as in matplotlib."""
    path = save(sketch, "one", "One", folder).png
    return np.asarray(Image.open(path).convert("RGB"))[::-1]


def at(sketch: Sketch, panel: int, x: float, y: float) -> tuple[int, int]:
    """Row and column in :func:`pixels` of a point in a panel's data coordinates."""
    place = sketch.canvas.axes[panel].transData.transform((x, y))
    return round(place[1]), round(place[0])


def colour(method: str) -> np.ndarray:
    return np.round(tone_map(np.array(LEVELS[method]), 1.0) * 255)


COST = {
    "break_even_views": {"SPPM": 9, "SPPM at equal quality": 20, "SPPM, views together": 33},
    "passes": {"SPPM": 30, "SPPM at equal quality": "20"},
    "preparation_seconds": 32.0,
    "seconds_per_view": {
        "GPF": 2.0,
        "SPPM": 6.0,
        "SPPM at equal quality": 3.7,
        "SPPM, views together": 3.0,
    },
}

_VIEWS = """\
exposure: 1.0
aspect: 1.5
views:
  train:
    - {name: front, origin: [0, 0, 4], target: [0, 0, 0], fov: 40}
  novel:
    - {name: near, origin: [1, 0, 4], target: [0, 0, 0], fov: 40}
    - {name: far, origin: [2, 0, 4], target: [0, 0, 0], fov: 40}
"""


def _image(method: str, worse: float) -> np.ndarray:
    image = np.full((*SIZE, 3), LEVELS[method], np.float32)
    if method == "gpf" and worse:
        row, column = FAR_OFF
        image[row : row + 8, column : column + 8] = 0
    return image


def _write_reference(path: Path) -> None:
    """A wall of constant radiance: a striped caustic on a texture that is its inverse."""
    arriving = np.full((*SIZE, 3), 0.5, np.float32)
    row, column = CAUSTIC
    arriving[row : row + 8 : 2, column : column + 8] = 2
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    layers = {
        "radiance": np.full((*SIZE, 3), LEVELS["reference"], np.float32),
        "reflectance": LEVELS["reference"] / arriving,
        "position": np.stack([x, y, 0 * x], axis=-1),
        "normal": np.broadcast_to(np.float32([0, 0, 1]), (*SIZE, 3)),
        "valid": np.ones(SIZE, np.float32),
    }
    write_exr(path, layers, {"passes_done": 30})
