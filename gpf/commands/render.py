"""`gpf render`: pictures of any views of a scene, from a field."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.commands.cameras import CameraChoice, Cameras, choose_cameras
from gpf.commands.data_set import write_data_set
from gpf.core.checkout import CHECKOUT
from gpf.core.errors import UserError
from gpf.core.films import write_film
from gpf.core.images import propose_exposure, read_exr, read_record, tone_map, write_exr, write_png
from gpf.core.progress import progress_bar, say
from gpf.core.random import pass_seed, stream_of
from gpf.core.runtime import choose_variant
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field
from gpf.rendering.aovs import parse_aovs
from gpf.rendering.denoiser import PACKAGE
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.fingerprint import changed_parts, fingerprint
from gpf.scene.load import load_scene_file
from gpf.scene.views import View

ROWS = 256
"""Rows of a picture, if no size is given."""

FILM, FPS = "film.mp4", 24

DENOISED_UP_TO = 16
"""Samples per pixel up to which pictures are denoised, if the package for it is installed. With
more samples, the denoiser may add larger errors than it removes."""


@dataclass(frozen=True)
class PictureOptions:
    """How the pictures are made.

    Attributes
    ----------
    size: ``WIDTHxHEIGHT`` or the number of rows alone; None for :data:`ROWS` rows.
    spp: samples per pixel; None for the default of :class:`RenderSettings`.
    seconds: time for a picture, instead of a number of samples.
    aovs: further layers of the EXR files, a list with commas.
    exposure: of the PNG files; None for that of the views' file, of the field, or a measured one.
    denoise: whether to denoise; None for what suits the number of samples.
    film: whether to write an MP4.
    seed: of all random numbers.
    changed_scene: whether to render with a field of another scene.
    """

    size: str | None = None
    spp: int | None = None
    seconds: float | None = None
    aovs: str = ""
    exposure: float | None = None
    denoise: bool | None = None
    film: bool = False
    seed: int = 0
    changed_scene: bool = False


def render_pictures(
    scene_name: str,
    field_file: Path | None,
    choice: CameraChoice,
    folder: Path | None,
    options: PictureOptions,
) -> None:
    """Render views as ``NAME.exr`` and ``NAME.png``, and write ``transforms.json``.

    Pictures that exist and were made in the same way are kept.

    Parameters
    ----------
    scene_name: a scene file, or in a checkout of the project the name of a trained scene.
    field_file: by default ``field.safetensors``, or that of the trained scene.
    folder: by default ``pictures``, or that of the trained scene.

    Raises
    ------
    UserError: a file, a view or an option is wrong, or the field is for another scene.
    """
    aovs = _read_aovs(options.aovs)
    if options.denoise and options.seconds is not None:
        raise UserError("--denoise and --seconds", "exclude each other", "Give --spp instead.")
    scene_file, trained = _find_scene(scene_name)
    field_file = field_file or (
        trained / "field.safetensors" if trained else Path("field.safetensors")
    )
    folder = folder or (trained / "pictures" if trained else Path("pictures"))
    choose_variant("auto")
    field = load_field(field_file)
    scene = load_scene_file(scene_file)
    if not options.changed_scene:
        require_same_scene(scene, scene_file, field, field_file)
    views_beside = trained / "views.yaml" if trained else None
    if choice.file is None and views_beside is not None and views_beside.exists():
        choice = CameraChoice(choice.names, views_beside, choice.frames, choice.orbit)
    cameras = choose_cameras(scene, scene_file, choice)
    pictures = Pictures.plan(scene, field, field_file, cameras, folder, aovs, options)
    start, made = time.perf_counter(), pictures.render()
    if options.film:
        pictures.write_film()
    write_data_set(folder, scene, cameras.views, pictures.size, aovs)
    kept = len(cameras.views) - made
    seconds = (time.perf_counter() - start) / max(made, 1)
    notes = [f"{made} picture{'s' if made != 1 else ''}, {seconds:.2f} s each"] if made else []
    notes += [f"{kept} were there already"] if kept else []
    say(f"{folder}: {'; '.join(notes)}")


def require_same_scene(
    scene: mi.Scene, scene_file: Path, field: GaussianPhotonField, field_file: Path
) -> None:
    """Raise a :class:`UserError` if a field was fitted to another scene, or to this one before it
    was changed; fields that do not say so are taken as they are."""
    known = field.record.get("fingerprint")
    if changed := changed_parts(known, fingerprint(scene)) if known else []:
        parts = " and ".join(", ".join(changed).rsplit(", ", 1))
        raise UserError(
            str(field_file),
            f"was fitted to another scene, or before {scene_file} was changed: other {parts}",
            "Run `gpf fit` again, or add --changed-scene to see the light of the other scene.",
        )


def _find_scene(name: str) -> tuple[Path, Path | None]:
    """The file of a scene, and, for the name of a trained scene, the folder of its results."""
    path = Path(name)
    if path.suffix or len(path.parts) > 1 or path.is_file() or CHECKOUT is None:
        return path, None
    field = Path(importlib.import_module("stages.commands.trained").find_field(name))
    return field.parent / "scene" / "scene.xml", field.parent


def _read_aovs(text: str) -> tuple[str, ...]:
    try:
        return parse_aovs(text)
    except ValueError as error:
        what, _, todo = str(error).partition("; ")
        raise UserError(f"--aovs {text}", what.partition(": ")[2], todo.capitalize()) from None


def _read_size(text: str | None, aspect: float) -> tuple[int, int]:
    """Width and height from ``WIDTHxHEIGHT`` or from the number of rows."""
    words = (text or str(ROWS)).lower().split("x")
    try:
        numbers = [int(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2) or not all(4 <= n <= 16384 for n in numbers):
        raise UserError(
            f"--size {text}", "is no size", "Give WIDTHxHEIGHT, such as 512x512, or rows alone."
        )
    rows = numbers[-1]
    return (numbers[0], rows) if len(numbers) == 2 else (max(1, round(rows * aspect)), rows)


@dataclass(frozen=True)
class Pictures:
    """The pictures of one call, and the facts that they depend on."""

    renderer: FieldRenderer
    views: tuple[View, ...]
    size: tuple[int, int]
    folder: Path
    exposure: float
    seconds: float | None
    seed: int
    facts: dict[str, Any]

    @classmethod
    def plan(
        cls,
        scene: mi.Scene,
        field: GaussianPhotonField,
        field_file: Path,
        cameras: Cameras,
        folder: Path,
        aovs: Sequence[str],
        options: PictureOptions,
    ) -> Pictures:
        """Decide what is not given."""
        size = _read_size(options.size, cameras.aspect)
        spp = options.spp or RenderSettings().spp
        denoise, available = options.denoise, importlib.util.find_spec("pyoidn") is not None
        if denoise is None:
            denoise = available and options.seconds is None and spp <= DENOISED_UP_TO
        if denoise and not available:
            raise UserError("--denoise", "needs the package pyoidn", f"pip install {PACKAGE}")
        settings = RenderSettings(spp=spp, denoise=denoise)
        renderer = FieldRenderer.make(scene, field, settings, aovs)
        exposure = options.exposure or cameras.exposure or field.record.get("exposure")
        if exposure is None:
            exposure = _measure_exposure(renderer, cameras.views[0], cameras.aspect)
        facts = {
            "method": "gpf",
            "field": hashlib.sha256(field_file.read_bytes()).hexdigest()[:16],
            "fingerprint": fingerprint(scene),
            "size": list(size),
            "seconds": options.seconds,
            "seed": options.seed,
            "aovs": list(aovs),
            "render": settings.model_dump(mode="json"),
        }
        return cls(
            renderer, cameras.views, size, folder, exposure, options.seconds, options.seed, facts
        )

    def render(self) -> int:
        """Render the pictures that are missing or out of date; their number."""
        missing = [view for view in self.views if not self.is_current(view)]
        with progress_bar(f"{self.folder.name}: rendering", len(self.views)) as bar:
            for done, view in enumerate(missing, start=len(self.views) - len(missing)):
                bar(done)
                seed = pass_seed(self.seed, 0, stream_of(f"picture {view.name}"))
                layers = self.renderer.render(view, self.size, seed, self.seconds)
                write_png(self.png(view), layers["radiance"], self.exposure)
                write_exr(self.exr(view), layers, self.record(view))
            bar(len(self.views))
        return len(missing)

    def png(self, view: View) -> Path:
        """The picture of a view."""
        return self.folder / f"{view.name}.png"

    def exr(self, view: View) -> Path:
        """Its radiance and AOVs."""
        return self.folder / f"{view.name}.exr"

    def record(self, view: View) -> dict[str, Any]:
        """What the picture of a view depends on, JSON values."""
        whole = {**self.facts, "exposure": self.exposure, "view": view.model_dump(mode="json")}
        return dict(json.loads(json.dumps(whole)))

    def is_current(self, view: View) -> bool:
        """Whether the files of a view exist and were made in this way."""
        found = read_record(self.exr(view)) if self.png(view).exists() else None
        return found is not None and {**found, **self.record(view)} == found

    def write_film(self) -> None:
        """All pictures in order as an MP4."""
        frames = []
        for view in self.views:
            shown = tone_map(read_exr(self.exr(view))[0]["radiance"], self.exposure)
            frames.append(np.round(255 * shown).astype(np.uint8))
        write_film(self.folder / FILM, frames, FPS)


def _measure_exposure(renderer: FieldRenderer, view: View, aspect: float) -> float:
    """An exposure for a view, from a small image."""
    size = max(1, round(64 * aspect)), 64
    layers = renderer.render(view, size, 0)
    return float(f"{propose_exposure(layers['radiance']):.3g}")
