"""Stage `scene`: copy a scene into results/, with everything that its builder generates."""

from __future__ import annotations

import os

from gpf.core.errors import UserError
from gpf.core.files import write_json
from gpf.core.partial import partial_folder, replace_folder
from gpf.scene.folders import load_views, scene_folder
from gpf.scene.snapshot import snapshot_scene
from stages.common.costs import CostMeter
from stages.common.inventory import scene_info
from stages.common.workspace import Workspace


def run(scene_name: str) -> None:
    """Build and copy the scene, load it once, and write a list of its contents."""
    work = Workspace.open(scene_name)
    if not load_views(scene_name).novel:
        raise UserError(
            f"{scene_folder(scene_name) / 'views.yaml'}: views.novel",
            "is empty, so the field cannot be compared with references",
            "Add a view that is not a training view.",
        )
    costs = CostMeter()
    with costs.measure("scene"):
        with partial_folder(work.scene_snapshot) as staging:
            copy = staging / "scene"
            snapshot_scene(scene_name, copy)
            os.replace(copy / "views.yaml", work.views_file)
            replace_folder(copy, work.scene_snapshot)
        scene = work.load_scene()
    write_json(work.folder / "scene.json", scene_info(scene))
    costs.write(work.cost("scene"))
