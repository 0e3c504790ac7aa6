"""The short films of the pages: `python docs/films.py [FILM]…`.

They are written to docs/images/*.webp.

`pool` flies over Water Caustic 2 while a field of it is fitted: at first one pass of photon mapping
per picture, then the fields after more and more passes. `lamps` dims and colours the two lamps of
Veach Bidir one by one. `water` dives through the surface of the basin. `waves`, `door` and `lamp`
are the animations of benchmarks/moving_scenes.py, by SPPM and by fields, in about the same time.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path

import gpf

# ruff: isort: split
import mitsuba as mi
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmarks.moving_scenes import ANIMATIONS, FRAME_RATE
from benchmarks.truth import sppm
from gpf.core.images import tone_map
from gpf.core.progress import progress_bar
from gpf.core.runtime import choose_variant
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field, save_field
from gpf.rendering.denoiser import available as has_denoiser
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.lights import LightMixer
from gpf.rendering.settings import RenderSettings
from gpf.scene.folders import load_views
from gpf.scene.frames import scene_frames
from gpf.scene.light_groups import LightGroups
from gpf.scene.sensors import make_sensor
from gpf.scene.snapshot import snapshot_scene
from gpf.scene.views import SceneViews

IMAGES = Path(__file__).parent / "images"
ROWS, SPP, MILLISECONDS = 224, 8, 90
PASSES = 648  # of the pool: 24, 72, 216 and all
RAW_FRAMES, FRAMES = 12, 15  # of photon mapping, and of each field
SECONDS = 150  # for the fits of the lamps and of the water
DIVE = 60  # frames through the water's surface
# Passes of a field and of SPPM in ten seconds, of animations with these rows, and the exposure in
# units of the scene's: an open door lets much light in
MOVING = {"waves": (20, 86, 256, 1), "door": (12, 39, 200, 0.4), "lamp": (30, 188, 256, 1)}


def main() -> None:
    """Make the films that are named, by default all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    films: dict[str, Callable[[], None]] = {
        "pool": film_pool,
        "lamps": film_lamps,
        "water": film_water,
        **{name: partial(film_moving, name) for name in MOVING},
    }
    parser.add_argument("films", nargs="*", default=list(films))
    for name in parser.parse_args().films:
        films[name]()


def film_pool() -> None:
    """A flight over the pool, better and better."""
    scene, views = _open("water_caustic_2")
    size = views.size(ROWS)
    with tempfile.TemporaryDirectory() as folder:
        fields: list[tuple[int, Path]] = []

        def keep(progress: gpf.fitting.fit.FitProgress) -> None:
            complete = progress.steps == progress.all_steps and progress.psnr is not None
            if progress.field is not None and complete:
                fields.append((progress.passes, Path(folder) / f"{progress.passes}.safetensors"))
                save_field(progress.field, fields[-1][1])

        sensors = [make_sensor(view, *size) for view in views.train]
        with progress_bar("water_caustic_2: fit", 1):
            gpf.fit(scene, sensors, passes=PASSES, callback=keep)
        fields = list(dict(fields).items())
        count = RAW_FRAMES + FRAMES * len(fields)
        path = views.path.model_copy(update={"frames": count})
        cameras = views.model_copy(update={"path": path}).frames()
        frames = []
        sppm = mi.load_dict({"type": "sppm", "photons_per_pass": 200_000})
        for k, camera in enumerate(cameras):
            if k < RAW_FRAMES:
                sensor = make_sensor(camera, *size)
                image = np.array(mi.render(scene, sensor=sensor, integrator=sppm, spp=1, seed=k))
                label = "photon mapping, one pass"
            else:
                passes, file = fields[(k - RAW_FRAMES) // FRAMES]
                if (k - RAW_FRAMES) % FRAMES == 0:
                    renderer = _renderer(scene, load_field(file))
                image = renderer.render(camera, size, seed=k)["radiance"]
                label = f"field after {passes} passes"
            frames.append(_label(image[..., :3], views.exposure, label))
    _write(IMAGES / "film_pool.webp", frames)


def film_lamps() -> None:
    """The lamps of a room, one by one."""
    scene, views = _open("veach_bidir")
    size = views.size(ROWS)
    sensors = [make_sensor(view, *size) for view in (*views.train[:12], *views.novel)]
    groups = LightGroups.each(scene)
    with progress_bar("veach_bidir: fit", 1):
        field = gpf.fit(scene, sensors, seconds=SECONDS, groups=groups)
    first, second = groups.names
    white, warm, blue = np.ones(3), np.array([1.0, 0.55, 0.2]), np.array([0.25, 0.45, 1.0])
    steps = [(white, white), (0 * white, white), (white, white), (white, 0 * white)]
    steps += [(warm, 0.3 * blue), (0.3 * blue, warm), (white, white)]
    mixer, renderer, frames = LightMixer(scene, field), _renderer(scene, field), []
    for before, after in pairwise(steps):
        for t in np.linspace(0, 1, 10, endpoint=False):
            share = t * t * (3 - 2 * t)
            one, other = ((1 - share) * b + share * a for b, a in zip(before, after, strict=True))
            mixer.set({first: tuple(map(float, one)), second: tuple(map(float, other))})
            image = renderer.render(views.train[8], size, seed=len(frames))["radiance"]
            label = f"{first} {one.mean():.0%}, {second} {other.mean():.0%}"
            frames.append(_label(image, views.exposure, label))
    _write(IMAGES / "film_lamps.webp", frames)


def film_water() -> None:
    """Down through the surface of the basin, through the water, and up again."""
    scene, views = _open("under_water")
    size = views.size(ROWS)
    with progress_bar("under_water: fit", 1):
        sensors = [make_sensor(view, *size) for view in views.train]
        field = gpf.fit(scene, sensors, seconds=SECONDS)
    path = views.path.model_copy(update={"frames": DIVE})
    renderer, frames = _renderer(scene, field, spp=4 * SPP), []
    for k, camera in enumerate(views.model_copy(update={"path": path}).frames()):
        image = renderer.render(camera, size, seed=k)["radiance"]
        frames.append(_picture(image, views.exposure))
    _write(IMAGES / "film_water.webp", frames)


def film_moving(name: str) -> None:
    """An animation, frame by frame: SPPM on the left, fields on the right."""
    choose_variant("auto")
    animation, (passes, sppm_passes, rows, brightness) = ANIMATIONS[name], MOVING[name]
    views = load_views(animation.scene)
    exposure = brightness * views.exposure
    size, view, frames = views.size(rows), views.find(animation.view), []
    with tempfile.TemporaryDirectory() as folder:
        files = [frame.file for frame in scene_frames(animation.write(Path(folder)))]
        sensors = [make_sensor(each, *size) for each in views.train]
        fields = gpf.fit_frames(map(gpf.load_scene_file, files), sensors, passes=passes)
        with progress_bar(name, len(files)) as bar:
            for k, (file, field) in enumerate(zip(files, fields, strict=True)):
                scene = gpf.load_scene_file(file)
                ours = _renderer(scene, field, spp=4 * SPP).render(view, size, seed=0)["radiance"]
                sums = (renderer := sppm(scene, [make_sensor(view, *size)], k)).empty_sums()
                for number in range(sppm_passes):
                    renderer.run_pass(1 + number, sums)
                theirs = renderer.view("0", sums).layers()["radiance"]
                both = ((theirs, "SPPM, ten seconds"), (ours, "field, ten seconds"))
                shown = [np.array(_label(each, exposure, text)) for each, text in both]
                frames.append(Image.fromarray(np.hstack(shown)))
                bar(k + 1)
    _write(IMAGES / f"film_{name}.webp", frames, round(1000 / FRAME_RATE))


def _open(name: str) -> tuple[mi.Scene, SceneViews]:
    choose_variant("auto")
    with tempfile.TemporaryDirectory() as folder:
        snapshot_scene(name, Path(folder) / name)
        scene = gpf.load_scene_file(Path(folder) / name / "scene.xml")
    return scene, load_views(name)


def _renderer(scene: mi.Scene, field: GaussianPhotonField, spp: int = SPP) -> FieldRenderer:
    return FieldRenderer.make(scene, field, RenderSettings(spp=spp, denoise=has_denoiser()))


def _picture(radiance: np.ndarray, exposure: float) -> Image.Image:
    return Image.fromarray(np.round(255 * tone_map(radiance, exposure)).astype(np.uint8))


def _label(radiance: np.ndarray, exposure: float, text: str) -> Image.Image:
    image = _picture(radiance, exposure)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(13)
    box = draw.textbbox((6, 5), text, font=font)
    draw.rectangle((box[0] - 4, box[1] - 3, box[2] + 4, box[3] + 3), fill=(20, 20, 20))
    draw.text((6, 5), text, font=font, fill=(240, 240, 240))
    return image


def _write(path: Path, frames: list[Image.Image], milliseconds: int = MILLISECONDS) -> None:
    """An endless film."""
    frames[0].save(
        path,
        save_all=True,
        append_images=frames[1:],
        duration=milliseconds,
        loop=0,
        quality=80,
        method=6,
        kmax=1,  # each frame by itself: else slow changes of light become blocks
    )
    print(f"{path}: {len(frames)} frames, {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
