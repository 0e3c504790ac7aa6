"""Stage `scene`: freeze a scene into results/, with everything that its builder generates."""

from __future__ import annotations

from gpf.artifacts import write_json
from gpf.scenes import freeze_scene, scene_info
from stages.workspace import Workspace


def prepare_scene(scene_name: str) -> None:
    """Build and copy the scene, load it once, and write down what it consists of."""
    work = Workspace.open(scene_name)
    freeze_scene(scene_name, work.frozen_scene)
    write_json(work.folder / "scene.json", scene_info(work.load_scene()))
