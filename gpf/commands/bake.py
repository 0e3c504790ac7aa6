"""`gpf bake`: the light of a field as light maps or vertex colours, for engines and pages."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.baking.atlas import unwrap
from gpf.baking.bake import LightMaps, bake_maps, bake_vertices, surfaces_to_bake
from gpf.baking.surfaces import Surface
from gpf.baking.writing import write_maps, write_vertices
from gpf.commands.bake_options import BakeOptions
from gpf.commands.baked_scene import write_scene
from gpf.commands.cameras import file_beside
from gpf.commands.overwriting import require_new
from gpf.commands.scenes import (
    find_field,
    find_scene,
    known_exposure,
    require_same_scene,
    title_of,
)
from gpf.core.files import write_json
from gpf.core.images import propose_exposure
from gpf.core.locks import sole_run
from gpf.core.partial import remove_leftovers
from gpf.core.progress import progress_bar, say
from gpf.core.runtime import choose_variant
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field
from gpf.scene.load import load_scene_file
from gpf.scene.untraceable import telling_untraceable

SIZE = 1024
"""Width and height of the maps, if nothing is asked for."""

INDEX = "index.json"


def bake_light(scene_name: str, field_name: str | None, folder: Path, options: BakeOptions) -> None:
    """Bake the light of a field, and write the files of :mod:`gpf.baking.writing` and an index,
    ``index.json``.

    Parameters
    ----------
    scene_name, field_name: as for :func:`gpf.commands.scenes.find_scene` and
        :func:`gpf.commands.scenes.find_field`.

    Raises
    ------
    UserError: a file or an option is wrong, the field is for another scene, there is nothing to
        bake, or xatlas is missing.
    """
    options.check()
    require_new(folder / INDEX, options.overwrite, "give another folder")
    for file in options.files().values():
        require_new(file, options.overwrite, "give another name")
    scene_file, trained = find_scene(scene_name)
    field_file = find_field(field_name, trained)
    choose_variant("auto")
    field = load_field(field_file)
    scene = load_scene_file(scene_file)
    require_same_scene(scene, scene_file, field, field_file, options.changed_scene)
    surfaces, left_out = surfaces_to_bake(scene)
    for name, why in left_out.items():
        say(f"left out: {name}: {why}")
    if backs := sum(surface.two_sided for surface in surfaces):
        say(f"two-sided: {backs} of {len(surfaces)} shapes, baked on the side of their normals")
    views = file_beside(trained / "scene.xml" if trained else scene_file, None)
    exposure = options.exposure or known_exposure(views, field)
    start = time.perf_counter()
    with sole_run(folder, inside=True), telling_untraceable(str(scene_file)):
        remove_leftovers(folder)
        index, baked = _bake(folder, scene, field, surfaces, options, exposure)
        if baked is not None:
            title = title_of(scene_name)
            write_scene(options, scene, field, baked, index["exposure"], views, title)
        write_json(folder / INDEX, {**index, "left_out": left_out})
    say(f"{folder}: {len(surfaces)} meshes, {time.perf_counter() - start:.1f} s")


def _bake(
    folder: Path,
    scene: mi.Scene,
    field: GaussianPhotonField,
    surfaces: list[Surface],
    options: BakeOptions,
    exposure: float | None,
) -> tuple[dict[str, Any], LightMaps | None]:
    """Bake and write light maps, or light at vertices; what the index says about them, and the
    maps."""
    if options.vertex_colours:
        with progress_bar("light at vertices", 1) as bar:
            lit = bake_vertices(scene, field, surfaces, options.spp, options.seed, bar)
        exposure = exposure or _measured_exposure(np.concatenate([part.light[""] for part in lit]))
        return {**write_vertices(folder, lit, exposure), "exposure": exposure}, None
    say(f"unwrapping {sum(len(surface.faces) for surface in surfaces)} triangles")
    size = options.size or (None if options.texels_per_unit else SIZE)
    atlas = unwrap(surfaces, size, options.texels_per_unit)
    start = time.perf_counter()
    with progress_bar("light at texels", 1) as bar:
        baked = bake_maps(scene, field, atlas, options.spp, options.seed, bar)
    width, height = atlas.size
    speed = baked.texels / (time.perf_counter() - start)
    say(f"{width}x{height}, {baked.texels} texels on surfaces, {speed:.0f} texels per second")
    exposure = exposure or _measured_exposure(baked.maps[""])
    index = write_maps(folder, baked, exposure)
    return {**index, "exposure": exposure, "texels_per_unit": atlas.texels_per_unit}, baked


def _measured_exposure(irradiance: np.ndarray) -> float:
    """An exposure for white surfaces in this light."""
    return float(f"{propose_exposure(irradiance / np.pi):.3g}")
