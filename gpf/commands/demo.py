"""`gpf demo`: a field for a pool of water, and pictures from it, in less than a minute."""

from __future__ import annotations

from pathlib import Path

from gpf.commands.cameras import CameraChoice
from gpf.commands.fit import fit_scene_file
from gpf.commands.fit_options import FitOptions
from gpf.commands.picture_options import PictureOptions
from gpf.commands.render import render_pictures
from gpf.core.errors import UserError
from gpf.core.progress import say
from gpf.core.runtime import choose_variant
from gpf.scene.snapshot import snapshot_scene

SECONDS, SPP = 20, 32


def run_demo(folder: Path, seconds: float = SECONDS) -> None:
    """Fit a field to a scene of the project and render its novel views, in a new folder.

    The equivalent commands are printed.

    Raises
    ------
    UserError: the folder exists.
    """
    if folder.exists():
        raise UserError(str(folder), "already exists", "Give another name, or remove it.")
    choose_variant("auto")
    # A link to the scene's folder; in a wheel, a copy of it.
    snapshot_scene("demo_scene", folder / "scene", Path(__file__).parent)
    scene, field = folder / "scene" / "scene.xml", folder / "field.safetensors"
    views, pictures = folder / "scene" / "views.yaml", folder / "pictures"
    say(f"$ gpf fit {scene} -o {field} --views {views} --seconds {seconds:g}")
    fit_scene_file(str(scene), field, FitOptions(seconds=seconds, views=views))
    say(f"$ gpf render {scene} --field {field} -o {pictures} --spp {SPP}")
    render_pictures(str(scene), str(field), CameraChoice(), pictures, PictureOptions(spp=SPP))
    say(f"Look at {pictures}. For your own scene: gpf fit SCENE.xml, then gpf render SCENE.xml.")
