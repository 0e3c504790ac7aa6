"""`gpf bake --glb` and `--html`: the scene itself in its baked light."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np

from gpf.baking.bake import LightMaps
from gpf.baking.gltf import Stage, write_glb
from gpf.baking.page import write_page
from gpf.baking.reflectance import bake_radiosity
from gpf.baking.surfaces import read_specular_surfaces
from gpf.core.files import write_atomically, write_text
from gpf.core.images import tone_map
from gpf.core.progress import say
from gpf.field.field import GaussianPhotonField
from gpf.scene.sensors import film_aspect, scene_cameras, views_of_sensors
from gpf.scene.views import View, read_views


@dataclass(frozen=True)
class SceneFiles:
    """A binary glTF file, and a web page; None for those that nobody asked for."""

    glb: Path | None
    html: Path | None


def write_scene(
    files: SceneFiles,
    scene: mi.Scene,
    field: GaussianPhotonField,
    baked: LightMaps,
    exposure: float,
    views: Path,
) -> None:
    """Write the scene as glTF and as a page; ``views``: its ``views.yaml``, which may not exist."""
    if files == SceneFiles(None, None):
        return
    groups = field.lights.groups if field.lights else None
    members = dict(zip(groups.names, groups.members, strict=True)) if groups else {}
    specular = read_specular_surfaces(scene)
    stage = Stage(scene, baked.atlas, specular, *_cameras(scene, views))
    if files.glb is not None:
        radiance = bake_radiosity(scene, baked, members)[""] / np.pi
        picture = np.round(255 * tone_map(radiance, exposure)).astype(np.uint8)
        data = write_glb(stage, picture, exposure)
        write_atomically(files.glb, lambda p: p.write_bytes(data))
        say(f"{files.glb}: {len(data) / 1e6:.1f} MB")
    if files.html is not None:
        title = files.html.stem.replace("_", " ")
        text = write_page(stage, baked, exposure, title, members)
        write_text(files.html, text)
        say(f"{files.html}: {len(text) / 1e6:.1f} MB")


def _cameras(scene: mi.Scene, file: Path) -> tuple[tuple[View, ...], float]:
    """The cameras of a file, or of the scene, and width divided by height of their pictures."""
    if file.is_file():
        known = read_views(file, need_training=False)
        return (*known.train, *known.novel, *known.more), known.aspect
    sensors = scene_cameras(scene)
    return tuple(views_of_sensors(scene)), film_aspect(sensors[0]) if sensors else 1.0
