"""The files that a scene file of another format names, whether they are there or not."""

from __future__ import annotations

import json
from pathlib import Path
from urllib.parse import unquote

import bpy


def named_files(file: Path) -> list[str]:
    """Absolute paths of these files, and of those that they name; without images, if Blender has
    them as such."""
    kind, names = file.suffix.lower(), set[str]()
    if kind == ".obj":
        with file.open(errors="replace") as lines:
            found = [line[6:].strip() for line in lines if line.startswith("mtllib")]
        names = {name for text in found for name in (text, *text.split())}  # several, or one
    elif kind == ".gltf":
        described = json.loads(file.read_text(encoding="utf-8"))
        parts = [*described.get("buffers", []), *described.get("images", [])]
        names = {unquote(part["uri"]) for part in parts if part.get("uri", "data:")[:5] != "data:"}
    elif kind.startswith(".usd"):
        names = named_layers(str(file))
    return sorted({str(file.parent / name) for name in names})


def named_layers(file: str) -> set[str]:
    """The layers that make up a USD scene."""
    bpy.utils.expose_bundled_modules()
    from pxr import Sdf, Tf

    names, waiting = set[str](), [file]
    while waiting:
        try:
            layer = Sdf.Layer.FindOrOpen(waiting.pop())
        except Tf.ErrorException:  # Blender leaves it out, too
            continue
        if layer is not None:
            found = map(layer.ComputeAbsolutePath, layer.GetCompositionAssetDependencies())
            new = {*found} - names
            names |= new
            waiting += new
    return names
