"""Invented results with images: a ramp with noise, different for each method and view."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gpf.core.files import read_json, write_json, write_text
from gpf.core.images import write_exr
from report.figures.sketch import Figure
from report.results import Results
from tests.report.made_up import BOX, WATER, make_results

WIDTH, HEIGHT = 12, 8
VIEWS = ("above", "below", "inside")
PSNR = {"above": 40.0, "below": 31.5, "inside": 44.0}
"""PSNR of the field. Its mean is 38.5: `above` is the typical view and `below` the worst."""


def make_pictured(
    root: Path, width: int = WIDTH, height: int = HEIGHT, scenes: Sequence[str] = (BOX, WATER)
) -> Results:
    """Results of the scenes, with images of three novel views of ``width`` × ``height`` pixels."""
    results = make_results(root)
    for scene in scenes:
        folder = root / scene
        write_text(folder / "views.yaml", _views())
        for path in sorted((folder / "metrics").glob("*.json")):
            found = read_json(path)
            if "mean" in found:
                views = {name: found["mean"] | {"psnr": PSNR[name]} for name in VIEWS}
                write_json(path, found | {"views": views})
                for view in VIEWS:
                    _write(results, scene, path.stem, view, width, height)
        for view in VIEWS:
            _write(results, scene, "reference", view, width, height)
        _write_cost(folder)
    return results


def radiance(method: str, view: str, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """The images of :func:`make_pictured`, (H, W, 3), from 1e-6 to 3e4."""
    rng = np.random.default_rng([*method.encode(), *view.encode()])
    ramp = np.geomspace(1e-6, 3e4, width * height * 3).reshape(height, width, 3)
    return (ramp * rng.uniform(0.5, 1, ramp.shape)).astype(np.float32)


def make_figure(folder: Path, name: str, size: int = 40) -> Figure:
    """A figure with an SVG and a PNG file."""
    folder.mkdir(parents=True, exist_ok=True)
    svg, png = folder / f"{name}.svg", folder / f"{name}.png"
    svg.write_text('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 4"/>', encoding="utf-8")
    pixels = np.random.default_rng(3).integers(0, 256, (size, size + 3, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(png, dpi=(180, 180))
    return Figure(name, f"Title of {name}", f"Alt of {name}", f"Caption of {name}", svg, png)


def _write(results: Results, scene: str, method: str, view: str, width: int, height: int) -> None:
    path = results.scene(scene).image(method, view)
    layer = (
        f"sppm_{results.params.reference.passes}" if method == "second_reference" else "radiance"
    )
    write_exr(path, {layer: radiance(method, view, width, height)}, {"view": view})


def _write_cost(folder: Path) -> None:
    machine = {"cpu": "A <processor>", "cores": 2, "python": "3.11.7", "commit": "0123456789"}
    machine |= {"packages": {"mitsuba": "3.9.1"}}
    for path in folder.glob("costs/**/*.json"):
        found: dict[str, Any] = read_json(path)
        write_json(path, found | {"machine": machine})
    cost = {"break_even_views": {"SPPM": 3}, "preparation_seconds": 60.0}
    cost |= {"seconds_per_view": {"GPF": 0.5, "SPPM": 20.0}}
    write_json(folder / "amortize.json", cost)
    gpf = read_json(folder / "metrics" / "gpf.json")
    gpf["equivalent_sppm_passes"] = {"above": "17", "below": "<3", "inside": ">30"}
    write_json(folder / "metrics" / "gpf.json", gpf)


def _views() -> str:
    camera = "origin: [0, 0, 4], target: [0, 0, 0], fov: 40"
    novel = ", ".join(f"{{name: {name}, {camera}}}" for name in VIEWS)
    train = f"{{name: front, {camera}}}"
    return f"exposure: 1.5\naspect: 1.5\nviews: {{train: [{train}], novel: [{novel}]}}\n"
