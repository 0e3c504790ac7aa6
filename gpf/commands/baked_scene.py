"""`gpf bake --glb`, `--html` and `--blend`: the scene itself in its baked light."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.baking.albedo import read_albedos
from gpf.baking.bake import LightMaps
from gpf.baking.gltf import Stage, light_from_afar, write_glb, write_unlit_glb
from gpf.baking.page import write_page
from gpf.baking.reflectance import bake_radiosity
from gpf.baking.surfaces import read_specular_surfaces
from gpf.baking.three_js import find_three
from gpf.blender.process import run_in_blender
from gpf.commands.bake_options import BakeOptions
from gpf.core.files import write_atomically, write_json, write_text
from gpf.core.images import tone_map, write_exr
from gpf.core.progress import console, say
from gpf.field.field import GaussianPhotonField
from gpf.scene.sensors import film_aspect, scene_cameras, views_of_sensors
from gpf.scene.views import View, read_views

ROWS = 1080
"""Rows of the pictures that Blender makes of the scene."""

SKY = (1024, 512)
"""Width and height of the picture of the environment that Blender gets."""


def write_scene(
    options: BakeOptions,
    scene: mi.Scene,
    field: GaussianPhotonField,
    baked: LightMaps,
    exposure: float,
    views: Path | None,
    title: str,
) -> None:
    """Write the scene as glTF, as a page with this title, and for Blender; ``views``: its
    ``views.yaml``, if it has one."""
    if not options.files():
        return
    groups = field.lights.groups if field.lights else None
    members = dict(zip(groups.names, groups.members, strict=True)) if groups else {}
    specular = read_specular_surfaces(scene)
    stage = Stage(scene, baked.atlas, specular, *_cameras(scene, views))
    if options.glb is not None:
        radiance = bake_radiosity(scene, baked, members)[""] / np.pi
        picture = np.round(255 * tone_map(radiance, exposure)).astype(np.uint8)
        data = write_glb(stage, picture, exposure)
        write_atomically(options.glb, lambda p: p.write_bytes(data))
        say(f"{options.glb}: {len(data) / 1e6:.1f} MB")
    if options.html is not None:
        three = find_three(options.three)
        text = write_page(stage, baked, exposure, title.replace("_", " "), members, three)
        write_text(options.html, text)
        say(f"{options.html}: {len(text) / 1e6:.1f} MB")
    if options.blend is not None:
        write_blend(options.blend, stage, baked, exposure, members)
        say(f"{options.blend}: {options.blend.stat().st_size / 1e6:.1f} MB")


def write_blend(
    file: Path,
    stage: Stage,
    baked: LightMaps,
    exposure: float,
    members: Mapping[str, Sequence[int]],
) -> None:
    """Have Blender write the scene, with its light as images."""
    albedos = read_albedos(chart.surface for chart in stage.atlas.charts)
    light = bake_radiosity(stage.scene, baked, members, apart=albedos)
    lights = {name: f"light_{k}.exr" for k, name in enumerate(n for n in light if n)}
    lights = lights or {"": "light.exr"}
    size = [round(ROWS * stage.aspect), ROWS]
    with tempfile.TemporaryDirectory() as name, console.status(f"{file.name}: Blender") as status:
        work = Path(name)
        (work / "scene.glb").write_bytes(write_unlit_glb(stage, albedos, 1.0))
        for group, image in lights.items():
            write_exr(work / image, {"radiance": light[group]}, {})
        facts: dict[str, Any] = {"exposure": exposure, "size": size, "lights": lights, "sky": None}
        if stage.scene.environment() is not None:
            write_exr(work / "sky.exr", {"radiance": light_from_afar(stage, *SKY)}, {})
            facts["sky"] = "sky.exr"
        write_json(work / "light.json", facts)
        result = work / "lit.blend"
        words = work, result
        run_in_blender("light_up.py", words, result, file, lambda what: status.update(what))
        write_atomically(file, lambda path: shutil.copyfile(result, path))


def _cameras(scene: mi.Scene, file: Path | None) -> tuple[tuple[View, ...], float]:
    """The cameras of a file, or of the scene, and width divided by height of their pictures."""
    if file is not None:
        known = read_views(file, need_training=False)
        return (*known.train, *known.novel, *known.more), known.aspect
    sensors = scene_cameras(scene)
    return tuple(views_of_sensors(scene)), film_aspect(sensors[0]) if sensors else 1.0
