"""A web page that shows a scene in its baked light, in one file: with three.js, without network."""

from __future__ import annotations

import base64
import gzip
import html
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gpf.baking.albedo import read_albedos
from gpf.baking.bake import LightMaps
from gpf.baking.gltf import Stage, light_from_afar, write_unlit_glb
from gpf.baking.reflectance import bake_radiosity, group_of_emitter
from gpf.baking.three_js import FILES

PAGE = Path(__file__).with_name("page.html")

SKY = (512, 256)
"""Width and height of the picture of a scene's environment."""

# RGB9_E5: three mantissas of 9 bits, and an exponent of 5 bits.
_MANTISSA, _BIAS, _EXPONENTS = 9, 15, (-15, 16)


def write_page(
    stage: Stage,
    baked: LightMaps,
    exposure: float,
    title: str,
    members: Mapping[str, Sequence[int]],
    three: Path,
) -> str:
    """The text of a page.

    Parameters
    ----------
    members: the indices in ``scene.emitters()`` of each group's emitters, by its name.
    three: a folder with three.js (:func:`gpf.baking.three_js.find_three`).
    """
    modules = {file.name: file for file in map(three.joinpath, FILES) if file.suffix == ".js"}
    groups = [name for name in baked.maps if name] or [""]
    width, height = baked.atlas.size
    albedos = read_albedos(chart.surface for chart in stage.atlas.charts)
    light = bake_radiosity(stage.scene, baked, members, apart=albedos)
    settings: dict[str, Any] = {
        "groups": groups,
        "width": width,
        "height": height,
        "modules": [*modules],
        "lamps": _groups_of_lamps(stage, members),
        "cameras": [view.name for view in stage.cameras],
    }
    files = {name: file.read_bytes() for name, file in modules.items()}
    files["scene"] = write_unlit_glb(stage, albedos, exposure)
    files["light"] = _differences(
        np.stack([pack_rgb9e5(exposure * light[name]) for name in groups])
    )
    if (sky := stage.scene.environment()) is not None:
        group = group_of_emitter(stage.scene, sky, members)
        settings["sky"] = {"width": SKY[0], "height": SKY[1], "group": group}
        files["sky"] = _picture_of_sky(stage, exposure).tobytes()
    # `<` would end the element that holds the text.
    said = json.dumps(settings, allow_nan=False).replace("<", "\\u003c")
    parts = [f'<script type="application/json" id="settings">{said}</script>']
    parts += [
        f'<script type="text/plain" id="{name}">{_pack(b)}</script>' for name, b in files.items()
    ]
    page = PAGE.read_text(encoding="utf-8").replace("{title}", html.escape(title))
    page = page.replace("{licence}", (three / "LICENSE").read_text(encoding="utf-8"))
    return page.replace("{parts}", "\n".join(parts))


def pack_rgb9e5(colours: np.ndarray) -> np.ndarray:
    """Colours (..., 3) with a common exponent, as WebGL reads them: (...,) uint32."""
    largest = (1 - 2.0**-_MANTISSA) * 2.0 ** _EXPONENTS[1]
    colours = np.clip(colours, 0, largest)
    peak = np.maximum(colours.max(axis=-1), 2.0 ** (_EXPONENTS[0] - 1))
    # Rounding may need one more bit.
    exponent = np.floor(np.log2(peak / (1 - 2.0 ** -(_MANTISSA + 1)))) + 1
    exponent = np.clip(exponent, *_EXPONENTS)
    scale = 2.0 ** (_MANTISSA - exponent)
    r, g, b = np.moveaxis(np.round(colours * scale[..., None]).astype(np.uint32), -1, 0)
    return r | g << 9 | b << 18 | (exponent + _BIAS).astype(np.uint32) << 27


def _groups_of_lamps(stage: Stage, members: Mapping[str, Sequence[int]]) -> dict[str, str]:
    """The groups of luminous surfaces, by the surfaces' names."""
    everything = [*(chart.surface for chart in stage.atlas.charts), *stage.specular]
    return {
        surface.name: group_of_emitter(stage.scene, surface.shape.emitter(), members)
        for surface in everything
        if surface.shape.is_emitter()
    }


def _differences(values: np.ndarray) -> bytes:
    """The bytes of uint32 values in four planes, each byte as the difference to the one before:
    gzip then makes a third less of light maps."""
    planes = values.astype("<u4").view(np.uint8).reshape(-1, 4).T
    return np.diff(planes, axis=1, prepend=np.uint8(0)).tobytes()


def _pack(data: bytes) -> str:
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode()


def _picture_of_sky(stage: Stage, exposure: float) -> np.ndarray:
    """The exposed light from all directions, (H, W, 4) float16: rows upwards from -y, columns from
    -x over -z."""
    width, height = SKY
    seen = light_from_afar(stage, width, height)[::-1]
    opaque = np.ones((height, width, 1))
    return np.concatenate([np.clip(exposure * seen, 0, 60000), opaque], axis=-1).astype("<f2")
