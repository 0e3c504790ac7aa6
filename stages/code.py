"""Stage `code`: what the code says on which each other stage depends.

DVC runs a stage again where one of the files that it lists has changed. Those of the library would
be some fifty for each; instead, each stage lists one file of this one, which has a line for each of
them. It changes where code does, but not where comments and docstrings do. Two such files side by
side show why a stage runs again.
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

FOLDER = Path("results") / "code"

# One has a file for each of its methods, the other none: it is this one.
BY_METHOD, OF_ITSELF = "baseline", "code"

# Imported for systems that learn from the field's targets.
FOR_TARGETS = "stages/field_effort.py"


def record_code() -> None:
    """Write results/code/STAGE.txt, and results/code/baselines/METHOD.txt for each system."""
    params = read_params()
    files = {
        f"{stage}.txt": files_of_stage(stage, module, params)
        for stage, (module, _) in STAGES.items()
        if stage not in (BY_METHOD, OF_ITSELF)
    }
    for method, options in params.baselines.items():
        files[f"baselines/{method}.txt"] = files_of_baseline(options)
    digests = {file: digest_file(PROJECT / file) for file in set().union(*files.values())}
    for name, decisive in files.items():
        lines = (f"{digests[file]}  {file}\n" for file in decisive)
        write_text(FOLDER / name, "".join(lines))


def files_of_stage(stage: str, module: str, params: Params) -> list[str]:
    """The project's files that decide what a stage writes."""
    loaded: set[str] = set()
    if stage == "scene":  # builders are loaded by their path
        builders = [scene_folder(scene) / "build.py" for scene in params.scenes]
        for builder in builders:
            loaded |= imports_of(str(builder.resolve())) if builder.exists() else set()
    if stage == "animate":  # systems by their names
        rows = [m for m in params.animation.methods if m in params.baselines]
        loaded |= {_file_of_system(params.baselines[method]) for method in rows}
    return closure(_file(module), *loaded)


def files_of_baseline(options: BaselineOptions) -> list[str]:
    """The project's files that decide what a system's images look like."""
    without = () if options.learns_from_targets else (FOR_TARGETS,)
    return closure(_file("stages.baseline"), _file_of_system(options), without=without)


def _file_of_system(options: BaselineOptions) -> str:
    return _file(f"gpf.baselines.{options.system}")


def _file(module: str) -> str:
    return module.replace(".", "/") + ".py"
