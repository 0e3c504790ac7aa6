"""`gpf mitsuba`: render a scene with its own integrator."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi

from gpf.blender.conversion import origin_of
from gpf.commands.overwriting import require_new
from gpf.commands.scenes import find_scene
from gpf.core.errors import UserError, is_interrupt
from gpf.core.files import write_atomically
from gpf.core.locks import sole_run
from gpf.core.machine import require_memory
from gpf.core.partial import remove_leftovers
from gpf.core.progress import say
from gpf.core.runtime import choose_variant
from gpf.scene.inventory import check_meshes
from gpf.scene.load import check_files, describe_plugin_error, load_with_parameters

# Suffix -> name in mi.Bitmap.FileFormat. Mitsuba cannot write floats to other formats.
FORMATS = {".exr": "OpenEXR", ".hdr": "RGBE", ".rgbe": "RGBE", ".pfm": "PFM"}
FORMATS |= {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}


def render_scene(
    scene_name: str,
    output: Path | None,
    define: Sequence[str],
    sensor: int,
    spp: int,
    seed: int,
    overwrite: bool = False,
) -> None:
    """Render a scene to an image file; the suffix chooses the format.

    Parameters
    ----------
    scene_name: as for :func:`gpf.commands.scenes.find_scene`.
    output: by default the name of the scene or of its file, with ``.exr``.
    define: parameters of the scene, each as ``name=value``.
    sensor: index of the sensor.
    spp: samples per pixel; 0 for the scene's own number.
    overwrite: whether to replace an image that exists.

    Raises
    ------
    UserError: the scene cannot be rendered, an option is wrong, or the image cannot be written.
    """
    choose_variant()
    values = {}
    for item in define:
        name, separator, value = item.partition("=")
        if not separator:
            raise UserError(f"-D {item}", "has no =", "Write -D name=value.")
        if name in ("config", "filename"):  # arguments of mi.parser.parse_file
            raise UserError(f"-D {item}", "has a name that Mitsuba reserves", "Choose another.")
        values[name] = value
    scene, trained = find_scene(scene_name)
    target = output or (Path(trained.name) if trained else origin_of(scene)).with_suffix(".exr")
    if target.suffix.lower() not in FORMATS:
        raise UserError(
            str(target), "is not the name of an image", f"Use the ending {', '.join(FORMATS)}."
        )
    if target.is_dir():
        raise UserError(str(target), "is a folder", "Name a file.")
    require_new(target, overwrite)
    check_files(scene, values)
    loaded = load_with_parameters(scene, values)
    check_meshes(loaded, str(scene))
    integrator, sensors = loaded.integrator(), loaded.sensors()
    if integrator is None or not sensors:
        missing = "an integrator" if integrator is None else "a sensor"
        raise UserError(str(scene), f"lacks {missing}", "Add one.")
    if sensor not in range(len(sensors)):
        raise UserError(
            f"-s {sensor}", f"the scene has {len(sensors)} sensors", "The first has index 0."
        )
    film = sensors[sensor].film()
    width, height = (int(n) for n in film.crop_size())
    # A film takes four floats or more for each pixel, an image one.
    require_memory(f"{scene}: film", f"{width}x{height}", 20 * width * height)
    start = time.perf_counter()
    with sole_run(target):
        remove_leftovers(target.parent)
        try:
            film.prepare(integrator.aov_names())
            _encode(film.develop(), target)  # fails before the time is spent
            image = integrator.render(loaded, sensors[sensor], seed=seed, spp=spp)
        except (RuntimeError, ValueError) as error:
            if is_interrupt(error):
                raise
            what = f"cannot be rendered: {describe_plugin_error(error)}"
            raise UserError(str(scene), what, "Correct the scene or the options.") from error
        content = _encode(image, target)
        write_atomically(target, lambda p: p.write_bytes(content))
    say(f"{target}: {time.perf_counter() - start:.1f} s")


def _encode(image: Any, target: Path) -> bytes:
    """The content of the image file ``target``.

    Encoded in memory: Mitsuba does not report a file that a full disk has cut short.
    """
    name, stream = FORMATS[target.suffix.lower()], mi.MemoryStream()
    try:
        bitmap = mi.util.convert_to_bitmap(image, uint8_srgb=name in ("PNG", "JPEG"))
        bitmap.write(stream, getattr(mi.Bitmap.FileFormat, name))
    except RuntimeError as error:
        what = f"cannot hold the image ({' '.join(str(error).split())})"
        raise UserError(str(target), what, "Use the ending .exr.") from error
    return bytes(stream.raw_buffer())
