"""The images of a scene, as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from nodes import Closure, plain_inputs


def used_files() -> list[str]:
    """The files that the scene uses beside its own."""
    paths = [bpy.path.abspath(lib.filepath) for lib in bpy.data.libraries]
    for image in bpy.data.images:
        if image.source == "FILE" and image.packed_file is None and image.filepath:
            paths.append(bpy.path.abspath(image.filepath, library=image.library))
    return sorted({str(Path(path).resolve()) for path in paths})


def missing_images() -> list[str]:
    """Images that are used, also by the world, but are not there or cannot be read."""
    return sorted(
        f"{image.name} ({image.filepath})"
        for image in bpy.data.images
        if image.source == "FILE" and image.users and not min(image.size)
    )


def write_images(closures: dict[tuple[str, int], Closure], folder: Path) -> dict[str, Any]:
    """Write the images that closures use; for each, its file and whether it is sRGB."""
    names = {v["image"] for c in closures.values() for v in plain_inputs(c) if "image" in v}
    images = {}
    for number, name in enumerate(sorted(names)):
        image = bpy.data.images[name]
        space = image.colorspace_settings.name
        stem = f"textures/image_{number}"
        images[name] = {"srgb": space == "sRGB", "file": None, "name": name}
        data = None
        if not min(image.size):  # missing
            continue
        if image.packed_file is not None:
            data = bytes(image.packed_file.data)
        elif image.source == "FILE":
            path = Path(bpy.path.abspath(image.filepath, library=image.library))
            data = path.read_bytes() if path.is_file() else None
            if data is None:
                continue
        kinds = {
            "PNG": "png",
            "JPEG": "jpg",
            "OPEN_EXR": "exr",
            "HDR": "hdr",
            "TARGA": "tga",
            "BMP": "bmp",
        }
        if data is not None and image.file_format in kinds and space in ("sRGB", "Non-Color"):
            file = f"{stem}.{kinds[image.file_format]}"
            (folder / file).write_bytes(data)
        else:
            pixels = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
            image.pixels.foreach_get(pixels)
            file = f"{stem}.npy"
            np.save(folder / file, pixels.reshape(image.size[1], image.size[0], -1))
            images[name]["srgb"] = space == "sRGB" and not image.is_float
        images[name]["file"] = file
    return images
