"""The images of a scene, as files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from nodes import Closure, plain_inputs


def used_files() -> list[str]:
    """The files that the scene uses beside its own."""
    paths = [bpy.path.abspath(lib.filepath) for lib in bpy.data.libraries]
    for cache in bpy.data.cache_files:  # Alembic and USD
        paths.append(bpy.path.abspath(cache.filepath, library=cache.library))
    for image in bpy.data.images:
        is_file = image.source in ("FILE", "SEQUENCE", "MOVIE") and image.packed_file is None
        if is_file and image.filepath:
            paths.append(bpy.path.abspath(image.filepath, library=image.library))
    return sorted({str(Path(path).resolve()) for path in paths})


def missing_images() -> list[str]:
    """Images that are used, also by the world, but are not there or cannot be read."""
    return sorted(
        f"{image.name} ({image.filepath})"
        for image in bpy.data.images
        if image.source == "FILE" and image.users and not min(image.size)
    )


KINDS = {
    "PNG": "png",
    "JPEG": "jpg",
    "OPEN_EXR": "exr",
    "HDR": "hdr",
    "TARGA": "tga",
    "BMP": "bmp",
}
"""Formats that are copied, and the ends of their files' names."""


def write_images(closures: Sequence[Closure], folder: Path, images: dict[str, Any]) -> None:
    """Write the images that closures use, but for those in ``images``, and add them there: for
    each, its file and whether it is sRGB."""
    names = {v["image"] for c in closures for v in plain_inputs(c) if "image" in v}
    for name in sorted(names - images.keys()):
        images[name] = _write_image(bpy.data.images[name], folder, f"textures/image_{len(images)}")


def _write_image(image: Any, folder: Path, stem: str) -> dict[str, Any]:
    space = image.colorspace_settings.name
    found = {"srgb": space == "sRGB", "file": None, "name": image.name}
    data = None
    if not min(image.size):  # missing
        return found
    if image.packed_file is not None:
        data = bytes(image.packed_file.data)
    elif image.source == "FILE":
        path = Path(bpy.path.abspath(image.filepath, library=image.library))
        data = path.read_bytes() if path.is_file() else None
        if data is None:
            return found
    if data is not None and image.file_format in KINDS and space in ("sRGB", "Non-Color"):
        found["file"] = f"{stem}.{KINDS[image.file_format]}"
        (folder / found["file"]).write_bytes(data)
    else:
        pixels = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        found["file"] = f"{stem}.npy"
        np.save(folder / found["file"], pixels.reshape(image.size[1], image.size[0], -1))
        found["srgb"] = space == "sRGB" and not image.is_float
    return found
