"""`gpf render`: pictures of any views of a scene, from a field."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from gpf.commands.cameras import CameraChoice, Cameras, choose_cameras
from gpf.commands.data_set import write_data_set
from gpf.commands.overwriting import require_new
from gpf.commands.picture_options import PictureOptions
from gpf.commands.pictures import Pictures, Rendering
from gpf.commands.scenes import find_field, find_scene, require_same_scene
from gpf.core.errors import UserError
from gpf.core.images import propose_exposure
from gpf.core.locks import sole_run
from gpf.core.partial import remove_leftovers
from gpf.core.progress import say
from gpf.core.random import pass_seed, stream_of
from gpf.core.runtime import choose_variant
from gpf.field.io import load_field
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.lights import set_lights
from gpf.scene.fingerprint import fingerprint
from gpf.scene.load import load_scene_file
from gpf.scene.untraceable import telling_untraceable
from gpf.scene.views import View


def render_pictures(
    scene_name: str,
    field_file: Path | None,
    choice: CameraChoice,
    folder: Path | None,
    options: PictureOptions,
) -> None:
    """Render views as ``NAME.exr`` and ``NAME.png``, and write ``transforms.json``.

    Pictures that exist and were made in the same way are kept; others are replaced only with
    ``options.overwrite``.

    Parameters
    ----------
    scene_name: as for :func:`gpf.commands.scenes.find_scene`.
    field_file: by default ``field.safetensors``, or that of the trained scene.
    folder: by default ``pictures``, or that of the trained scene.

    Raises
    ------
    UserError: a file, a view or an option is wrong, or the field is for another scene.
    """
    options.check()
    scene_file, trained = find_scene(scene_name)
    if field_file is None:
        field_file = find_field(scene_name) if trained else Path("field.safetensors")
    folder = folder or (trained or Path()) / "pictures"
    choose_variant("auto")
    field, layers = load_field(field_file), options.layers()
    if "error" in layers and field.error is None:
        raise UserError(
            str(field_file), "has no error estimate", "Fit it with `gpf fit`, or leave out error."
        )
    scene = load_scene_file(scene_file)
    require_same_scene(scene, scene_file, field, field_file, options.changed_scene)
    if options.lights:
        set_lights(scene, field, options.lights)
    if trained and choice.file is None and (trained / "views.yaml").exists():
        choice = replace(choice, file=trained / "views.yaml")
    cameras = choose_cameras(scene, scene_file, choice)
    size, settings = options.film_size(cameras.aspect), options.render_settings()
    rendered = layers if "coverage" in layers else (*layers, "coverage")
    exposure = options.exposure or cameras.exposure or field.record.get("exposure")
    with telling_untraceable(str(scene_file)):
        renderer = FieldRenderer.make(scene, field, settings, rendered)
        if exposure is None:
            exposure = _measure_exposure(renderer, cameras)
    facts = {
        "method": "gpf",
        "field": hashlib.sha256(field_file.read_bytes()).hexdigest()[:16],
        "fingerprint": fingerprint(scene),
        "size": list(size),
        "seconds": options.seconds,
        "seed": options.seed,
        "aovs": list(layers),
        "lights": options.lights,
        "render": settings.model_dump(mode="json"),
    }
    pictures = Pictures(folder, cameras.views, layers, exposure, facts)
    start = time.perf_counter()
    render = partial(_render, renderer, size, options, scene_file, field_file)
    with sole_run(folder, inside=True), telling_untraceable(str(scene_file)):
        remove_leftovers(folder)
        for view in cameras.views:
            if pictures.is_another(view):
                require_new(pictures.exr(view), options.overwrite, "give another folder")
        made = pictures.render(render)
        if options.film:
            pictures.write_film()
        write_data_set(folder, scene, cameras.views, size, layers)
    for remark in pictures.remarks():
        say(f"{folder}: {remark}")
    kept = len(cameras.views) - made
    seconds = (time.perf_counter() - start) / max(made, 1)
    notes = [f"{made} picture{'s' if made != 1 else ''}, {seconds:.2f} s each"] if made else []
    notes += [f"{kept} already done"] if kept else []
    say(f"{folder}: {'; '.join(notes)}")


def _measure_exposure(renderer: FieldRenderer, cameras: Cameras) -> float:
    """An exposure for the first view, from a small image."""
    size = max(1, round(64 * cameras.aspect)), 64
    layers = renderer.render(cameras.views[0], size, 0)
    return float(f"{propose_exposure(layers['radiance']):.3g}")


def _render(
    renderer: FieldRenderer,
    size: tuple[int, int],
    options: PictureOptions,
    scene_file: Path,
    field_file: Path,
    views: list[View],
) -> Iterator[Rendering]:
    """Render views one after the other, or on a Ray cluster."""
    streams = {view.name: stream_of(f"picture {view.name}") for view in views}
    seeds = {name: pass_seed(options.seed, 0, stream) for name, stream in streams.items()}
    if options.executor != "ray":
        for view in views:
            yield view, renderer.render(view, size, seeds[view.name], options.seconds)
        return
    from gpf.commands.cluster import RenderJob, pack_scene, render_on_cluster

    job = RenderJob(
        *pack_scene(scene_file),
        field_file.read_bytes(),
        renderer.settings,
        renderer.aovs,
        size,
        options.seconds,
        options.lights,
    )
    yield from render_on_cluster(job, seeds, views, options.cluster)
