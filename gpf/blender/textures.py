"""Images of a scene that Blender has read, as textures of Mitsuba."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from PIL import Image

from gpf.core.images import tone_map, undo_tone_map
from gpf.core.vectors import normalise

Dict = dict[str, Any]

WRAP = {"REPEAT": "repeat", "EXTEND": "clamp", "CLIP": "clamp", "MIRROR": "mirror"}

FLAT = 1 / 512
"""An image whose values differ by less is a single value."""


class Textures:
    """Turns the inputs of closures into values of a Mitsuba dictionary, and writes their files.

    Parameters
    ----------
    work: what Blender wrote.
    folder: the scene's folder; files go to ``textures`` in it.
    images: the images of the description, by name.

    Attributes
    ----------
    suffix: ends the names of new files; those of earlier frames are used again.
    """

    def __init__(self, work: Path, folder: Path, images: Mapping[str, Mapping[str, Any]]) -> None:
        self.work, self.folder, self.images = work, folder, images
        self.suffix = ""
        self._made: dict[tuple[Any, ...], Any] = {}

    def sky_file(self, *origin: Any) -> str:
        """The file of a sky that is made from this."""
        return str(self._made.setdefault(("sky", repr(origin)), f"textures/sky{self.suffix}.exr"))

    def __call__(self, value: Any, role: str) -> Any:
        """An input in its role: "color", "value", "normal" or "radiance"."""
        if isinstance(value, (int, float)):
            return float(value) if role == "value" else _rgb([value] * 3)
        if isinstance(value, list):
            return _luminance(value) if role == "value" else _rgb(value)
        if "attribute" in value:
            return {"type": "mesh_attribute", "name": "vertex_color"}
        if "minus" in value:
            return self._inverse(value["minus"])
        key = role, _content(value)
        if key not in self._made:
            self._made[key] = self._make(value, role, f"{len(self._made):03}{self.suffix}")
        made = self._made[key]
        return _placed(made, value) if isinstance(made, dict) and made["type"] == "bitmap" else made

    def _inverse(self, value: Any) -> Any:
        """1 - value."""
        if isinstance(value, (int, float)):
            return 1.0 - value
        key = "inverse", _content(value)
        if key not in self._made:
            name = f"{len(self._made):03}i{self.suffix}"
            self._made[key] = self._write(1 - _grey(self._pixels(value)), name, "value")
        return _placed(self._made[key], value)

    def _make(self, value: Mapping[str, Any], role: str, name: str) -> Any:
        """A bitmap, or a plain value if the image is flat or missing."""
        image = self.images.get(value.get("image", ""), {})
        if image.get("file", "") is None:  # missing
            pink = [1.0, 0.0, 1.0]  # as Blender shows it
            if role == "value":
                return 1.0 if value.get("channel") == "a" else _luminance(pink)
            return _rgb(pink)
        file = image.get("file")
        whole = value.get("channel") is None and role != "normal" and "scale" not in value
        if file and not file.endswith(".npy") and whole:
            target = self.folder / file
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(self.work / file, target)
            return {"type": "bitmap", "filename": file, "raw": not image["srgb"]}
        pixels = self._pixels(value)
        if role == "normal":
            pixels = _bent(pixels, value.get("strength", 1.0))
        if role == "value":
            pixels = _grey(pixels)
        pixels = pixels + value.get("offset", 0.0)
        if np.ptp(pixels.reshape(-1, pixels.shape[2]), axis=0).max() < FLAT and role != "normal":
            mean = pixels.mean(axis=(0, 1))
            return float(mean[0]) if role == "value" else _rgb(mean.tolist(), role)
        return self._write(pixels, name, role)

    def _pixels(self, value: Mapping[str, Any]) -> np.ndarray:
        """Linear values from the top, (H, W, C)."""
        image = self.images.get(value.get("image", ""), {})
        file = self.work / (value["array"] if "array" in value else image["file"])
        if file.suffix == ".npy":
            pixels = np.load(file)[::-1].astype(np.float32)
        else:
            bitmap = mi.Bitmap(str(file))
            bitmap.set_srgb_gamma(False)
            kept = bitmap.convert(component_format=mi.Struct.Type.Float32, srgb_gamma=False)
            pixels = np.array(kept, dtype=np.float32)
            pixels = pixels[..., None] if pixels.ndim == 2 else pixels
        channel = value.get("channel")
        if channel is not None:
            at = min("rgba".index(channel), pixels.shape[2] - 1)
            pixels = pixels[..., at : at + 1]
        if image.get("srgb") and channel != "a":
            pixels = undo_tone_map(pixels).astype(np.float32)
        pixels = pixels[..., :3]
        return pixels * np.array(value["scale"], np.float32) if "scale" in value else pixels

    def _write(self, pixels: np.ndarray, name: str, role: str) -> Dict:
        folder = self.folder / "textures"
        folder.mkdir(parents=True, exist_ok=True)
        if role == "radiance":
            path = folder / f"{name}.exr"
            mi.Bitmap(np.ascontiguousarray(pixels, np.float32)).convert(
                component_format=mi.Struct.Type.Float16
            ).write(str(path))
            return {"type": "bitmap", "filename": f"textures/{path.name}", "raw": True}
        path = folder / f"{name}.png"
        raw = role != "color"
        shown = np.clip(pixels, 0, 1) if raw else tone_map(pixels, 1.0)
        if role == "normal":
            mi.Bitmap((shown * 65535 + 0.5).astype(np.uint16)).write(str(path))
        else:
            eight = (shown * 255 + 0.5).astype(np.uint8)
            Image.fromarray(eight[..., 0] if eight.shape[2] == 1 else eight).save(path)
        return {"type": "bitmap", "filename": f"textures/{path.name}", "raw": raw}


def _content(value: Mapping[str, Any]) -> str:
    """What the pixels of an input depend on."""
    names = ("image", "array", "channel", "strength", "scale", "offset")
    return repr([value.get(name) for name in names])


def _placed(bitmap: Dict, value: Mapping[str, Any]) -> Dict:
    """A bitmap where an input has it on the surface."""
    found = dict(bitmap)
    if (wrap := WRAP.get(value.get("extension", "REPEAT"), "repeat")) != "repeat":
        found["wrap_mode"] = wrap
    if value.get("closest"):
        found["filter_type"] = "nearest"
    to_uv = value.get("to_uv", [[1, 0, 0], [0, 1, 0]])
    if to_uv != [[1, 0, 0], [0, 1, 0]]:
        flip = np.array([[1, 0, 0], [0, -1, 1], [0, 0, 1]])  # meshes and images begin at the top
        found["to_uv"] = mi.ScalarTransform3f(flip @ np.array([*to_uv, [0, 0, 1.0]]) @ flip)
    return found


def _rgb(colour: list[float], role: str = "color") -> Dict:
    most = 1.0 if role == "color" else np.inf
    return {"type": "rgb", "value": [float(np.clip(c, 0.0, most)) for c in colour]}


def _luminance(colour: Any) -> float:
    return float(np.dot(colour[:3], (0.2126, 0.7152, 0.0722)))


def _grey(pixels: np.ndarray) -> np.ndarray:
    """One channel, as Blender converts colours to numbers."""
    if pixels.shape[2] == 1:
        return pixels
    grey: np.ndarray = (pixels @ np.array([0.2126, 0.7152, 0.0722], np.float32))[..., None]
    return grey


def _bent(pixels: np.ndarray, strength: float) -> np.ndarray:
    """A normal map with another strength."""
    normal = 2 * pixels - 1
    normal[..., :2] *= strength
    normal[..., 2] = np.maximum(normal[..., 2], 1e-3)
    return 0.5 * normalise(normal) + 0.5
