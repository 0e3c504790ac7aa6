"""Stage `code`: what the code says on which each other stage depends.

DVC runs a stage again where one of the files that it lists has changed. Those of the library would
be some fifty for each; instead, each stage lists one file of this one, which has a line for each of
them. It changes where code does, but not where comments and docstrings do; what it was before and
what it is now show why a stage runs again.
"""

from __future__ import annotations

from pathlib import Path

from gpf.artifacts import write_text
from gpf.baselines.options import BaselineOptions
from gpf.config import Params, read_params
from gpf.scene_folders import scene_folder
from stages.cli import STAGES
from stages.code_digest import digest_file
from stages.imports import PROJECT, closure, imports_of

CODE_FOLDER = Path("results") / "code"

# These have a file for each scene and for each system; this stage has none.
SCENE, BASELINE, CODE = "scene", "baseline", "code"

# Imported for systems that learn from the field's targets.
FOR_TARGETS = "stages/field_effort.py"


def record_code() -> None:
    """Write what the code of all stages says, below results/code: STAGE.txt, scenes/SCENE.txt and
    baselines/METHOD.txt."""
    params = read_params()
    stages = [stage for stage in STAGES if stage not in (SCENE, BASELINE, CODE)]
    files = {f"{stage}.txt": files_of_stage(stage, params) for stage in stages}
    files |= {f"scenes/{scene}.txt": files_of_scene(scene) for scene in params.scenes}
    files |= {f"baselines/{m}.txt": files_of_baseline(o) for m, o in params.baselines.items()}
    digests = {file: digest_file(PROJECT / file) for file in set().union(*files.values())}
    for name, decisive in files.items():
        lines = (f"{digests[file]}  {file}\n" for file in decisive)
        write_text(CODE_FOLDER / name, "".join(lines))


def files_of_stage(stage: str, params: Params) -> list[str]:
    """The project's files that decide what a stage writes, for any scene."""
    systems: list[str] = []
    if stage == "animate":  # loads them by their names
        rows = [m for m in params.animation.methods if m in params.baselines]
        systems = [_file_of_system(params.baselines[method]) for method in rows]
    return closure(_file(STAGES[stage][0]), *systems)


def files_of_scene(scene: str) -> list[str]:
    """The project's files that decide what a scene is frozen to, beside its own folder."""
    builder = (scene_folder(scene) / "build.py").resolve()  # loaded by its path
    loaded = imports_of(str(builder)) if builder.exists() else ()
    return closure(_file(STAGES[SCENE][0]), *loaded)


def files_of_baseline(options: BaselineOptions) -> list[str]:
    """The project's files that decide what a system's images look like."""
    without = () if options.learns_from_targets else (FOR_TARGETS,)
    return closure(_file(STAGES[BASELINE][0]), _file_of_system(options), without=without)


def _file_of_system(options: BaselineOptions) -> str:
    return _file(f"gpf.baselines.{options.system}")


def _file(module: str) -> str:
    return module.replace(".", "/") + ".py"
