"""`gpf render`: pictures of any views of a scene, from a field."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.commands.cameras import CameraChoice, Cameras, choose_cameras
from gpf.commands.data_set import layer_files, write_data_set
from gpf.commands.scenes import find_field, find_scene, require_same_scene
from gpf.core.errors import UserError
from gpf.core.films import find_encoder, write_film
from gpf.core.images import propose_exposure, read_exr, read_record, tone_map, write_exr, write_png
from gpf.core.locks import sole_run
from gpf.core.partial import remove_leftovers
from gpf.core.progress import progress_bar, say
from gpf.core.random import pass_seed, stream_of
from gpf.core.runtime import choose_variant, require_memory
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field
from gpf.rendering.aovs import expected_psnr, parse_aovs
from gpf.rendering.denoiser import PACKAGE
from gpf.rendering.denoiser import available as has_denoiser
from gpf.rendering.field_renderer import FieldRenderer, describe_coverage, weakly_covered
from gpf.rendering.lights import set_lights
from gpf.rendering.settings import RenderSettings
from gpf.scene.fingerprint import fingerprint
from gpf.scene.load import load_scene_file
from gpf.scene.untraceable import telling_untraceable
from gpf.scene.views import View

ROWS = 256
"""Rows of a picture, if no size is given."""

FILM, FPS = "film.mp4", 24

WORTH_SAYING = 0.02
"""A message warns of pictures with more than this share of weakly covered pixels."""


Rendering = tuple[View, dict[str, np.ndarray]]
"""A view and its layers."""


@dataclass(frozen=True)
class PictureOptions:
    """How the pictures are made.

    Attributes
    ----------
    size: ``WIDTHxHEIGHT`` or the number of rows alone; None for :data:`ROWS` rows.
    spp: samples per pixel; None for the default of :class:`RenderSettings`.
    seconds: time for a picture, instead of a number of samples.
    aovs: further layers of the EXR files, separated by commas.
    exposure: exposure of the PNG files; None for that of the views' file or of the field, or else a
        measured one.
    denoise: whether to denoise; None to do so if the package for it is installed.
    film: whether to write an MP4.
    seed: random seed.
    changed_scene: whether to accept a field of another scene.
    executor: ``local``, or ``ray`` to spread the pictures over a cluster.
    cluster: address of the cluster; empty to start one on this machine.
    lights: levels of groups of emitters (:func:`gpf.scene.light_groups.parse_levels`).
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
    executor: str = "local"
    cluster: str = ""
    lights: str = ""


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
    scene_name: as for :func:`gpf.commands.scenes.find_scene`.
    field_file: by default ``field.safetensors``, or that of the trained scene.
    folder: by default ``pictures``, or that of the trained scene.

    Raises
    ------
    UserError: a file, a view or an option is wrong, or the field is for another scene.
    """
    aovs = _read_aovs(options.aovs)
    if options.denoise and options.seconds is not None:
        raise UserError("--denoise and --seconds", "are mutually exclusive", "Give --spp instead.")
    for option in ("seconds", "exposure"):
        value = getattr(options, option)
        if value is not None and not 0 < value < math.inf:  # or NaN
            raise UserError(f"--{option}", f"is {value}", "Give a number above 0, or leave it out.")
    if options.cluster and options.executor != "ray":
        raise UserError("--cluster", "needs `--executor ray`", "Give both, or leave it out.")
    if options.film:
        find_encoder()  # before the frames are rendered
    scene_file, trained = find_scene(scene_name)
    if field_file is None:
        field_file = find_field(scene_name) if trained else Path("field.safetensors")
    folder = folder or (trained / "pictures" if trained else Path("pictures"))
    choose_variant("auto")
    field = load_field(field_file)
    if "error" in aovs and field.error is None:
        raise UserError(
            str(field_file), "has no error estimate", "Fit it with `gpf fit`, or leave out error."
        )
    scene = load_scene_file(scene_file)
    require_same_scene(scene, scene_file, field, field_file, options.changed_scene)
    if options.lights:
        set_lights(scene, field, options.lights)
    views_beside = trained / "views.yaml" if trained else None
    if choice.file is None and views_beside is not None and views_beside.exists():
        choice = CameraChoice(choice.names, views_beside, choice.frames, choice.orbit)
    cameras = choose_cameras(scene, scene_file, choice)
    with telling_untraceable(str(scene_file)):  # measures the exposure, if none is given
        pictures = Pictures.plan(scene, field, field_file, cameras, folder, aovs, options)
    start = time.perf_counter()
    renderings = pictures.on_this_machine
    if options.executor == "ray":
        places = scene_file, field_file, options.cluster, options.lights
        renderings = partial(pictures.on_cluster, *places)
    with sole_run(folder, inside=True), telling_untraceable(str(scene_file)):
        remove_leftovers(folder)
        made = pictures.render(renderings)
        if options.film:
            pictures.write_film()
        write_data_set(folder, scene, cameras.views, pictures.size, aovs)
    for remark in pictures.remarks():
        say(f"{folder}: {remark}")
    kept = len(cameras.views) - made
    seconds = (time.perf_counter() - start) / max(made, 1)
    notes = [f"{made} picture{'s' if made != 1 else ''}, {seconds:.2f} s each"] if made else []
    notes += [f"{kept} already done"] if kept else []
    say(f"{folder}: {'; '.join(notes)}")


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
            f"--size {text}", "is not a size", "Give WIDTHxHEIGHT, such as 512x512, or rows alone."
        )
    rows = numbers[-1]
    width = numbers[0] if len(numbers) == 2 else max(1, round(rows * aspect))
    require_memory("--size", f"{width}x{rows}", 40 * width * rows)  # layers, and copies of them
    return width, rows


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
        """Decide whatever is not given."""
        size = _read_size(options.size, cameras.aspect)
        spp = options.spp or RenderSettings().spp
        denoise = options.denoise
        if denoise is None:
            denoise = has_denoiser() and options.seconds is None
        if denoise and not has_denoiser():
            raise UserError(
                "--denoise", "needs the package pyoidn", f"Run `pip install {PACKAGE}`."
            )
        settings = RenderSettings(spp=spp, denoise=denoise)
        layers = (*aovs, *(("coverage",) if "coverage" not in aovs else ()))
        renderer = FieldRenderer.make(scene, field, settings, layers)
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
            "lights": options.lights,
            "render": settings.model_dump(mode="json"),
        }
        return cls(
            renderer, cameras.views, size, folder, exposure, options.seconds, options.seed, facts
        )

    def render(self, renderings: Callable[[list[View]], Iterable[Rendering]]) -> int:
        """Render the pictures that are missing or out of date; return their number."""
        missing = [view for view in self.views if not self.is_current(view)]
        done = len(self.views) - len(missing)
        with progress_bar(f"{self.folder.name}: rendering", len(self.views)) as bar:
            bar(done)
            for view, layers in renderings(missing) if missing else ():
                # Those of an earlier picture, which may have another size.
                for file in layer_files(self.folder, view).values():
                    file.unlink(missing_ok=True)
                write_png(self.png(view), layers["radiance"], self.exposure)
                facts = self.record(view)
                if "error" in layers:
                    facts["expected_psnr"] = expected_psnr(
                        layers["radiance"], layers["error"], self.exposure
                    )
                facts["weakly_covered"] = weakly_covered(layers["coverage"])
                wanted = ("radiance", *self.facts["aovs"])
                write_exr(self.exr(view), {name: layers[name] for name in wanted}, facts)
                done += 1
                bar(done)
        return len(missing)

    def on_this_machine(self, views: list[View]) -> Iterator[Rendering]:
        """Render views one after the other."""
        for view in views:
            yield view, self.renderer.render(view, self.size, self.seed_of(view), self.seconds)

    def on_cluster(
        self, scene_file: Path, field_file: Path, address: str, lights: str, views: list[View]
    ) -> Iterator[Rendering]:
        """Render views on a Ray cluster."""
        from gpf.commands.cluster import RenderJob, pack_scene, render_on_cluster

        job = RenderJob(
            *pack_scene(scene_file),
            field_file.read_bytes(),
            self.renderer.settings,
            self.renderer.aovs,
            self.size,
            self.seconds,
            lights,
        )
        seeds = {view.name: self.seed_of(view) for view in views}
        return render_on_cluster(job, seeds, views, address)

    def seed_of(self, view: View) -> int:
        """The seed of a view's samples."""
        return pass_seed(self.seed, 0, stream_of(f"picture {view.name}"))

    def png(self, view: View) -> Path:
        """The picture of a view."""
        return self.folder / f"{view.name}.png"

    def exr(self, view: View) -> Path:
        """The radiance and AOVs of a view."""
        return self.folder / f"{view.name}.exr"

    def record(self, view: View) -> dict[str, Any]:
        """What the picture of a view depends on, as JSON values."""
        whole = {**self.facts, "exposure": self.exposure, "view": view.model_dump(mode="json")}
        return dict(json.loads(json.dumps(whole)))

    def is_current(self, view: View) -> bool:
        """Whether the files of a view exist and were made with these settings."""
        found = read_record(self.exr(view)) if self.png(view).exists() else None
        return found is not None and {**found, **self.record(view)} == found

    def remarks(self) -> Iterator[str]:
        """Say how wrong the light of the pictures may be, and where it is missing."""
        records = {view.name: read_record(self.exr(view)) or {} for view in self.views}
        if any("expected_psnr" in record for record in records.values()):
            found = [r["expected_psnr"] for r in records.values() if "expected_psnr" in r]
            yield (
                f"light accurate to {np.mean(found):.1f} dB "
                f"({min(found):.1f} to {max(found):.1f}), plus noise of the camera samples"
            )
        shares = {name: record.get("weakly_covered", 0.0) for name, record in records.items()}
        if max(shares.values()) > WORTH_SAYING:
            yield f"{describe_coverage(shares)}; fit with cameras that see them"

    def write_film(self) -> None:
        """Write all pictures, in order, as an MP4."""

        def frame(view: View) -> np.ndarray:
            shown = tone_map(read_exr(self.exr(view))[0]["radiance"], self.exposure)
            return np.round(255 * shown).astype(np.uint8)

        write_film(self.folder / FILM, map(frame, self.views), FPS)


def _measure_exposure(renderer: FieldRenderer, view: View, aspect: float) -> float:
    """An exposure for a view, from a small image."""
    size = max(1, round(64 * aspect)), 64
    layers = renderer.render(view, size, 0)
    return float(f"{propose_exposure(layers['radiance']):.3g}")
