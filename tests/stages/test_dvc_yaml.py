"""dvc.yaml declares what the stages really depend on: modules, parameters and files."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from ruamel.yaml import YAML
from stages.code import files_of_baseline, files_of_scene, files_of_stage
from stages.imports import PACKAGES

from gpf.cli import OF_ALL_SCENES, STAGES
from gpf.config.params import Params, read_params
from tests.stages.results import SMOKE_STAGES

PROJECT = Path(__file__).parent.parent.parent
PARAMS = read_params(PROJECT / "params.yaml")
# Who renders a pass changes no bit of it; DVC calls `baseline` for each method by itself, and
# `ablation` for each variant.
WHO_RENDERS = {"executor", "cluster", "methods", "ablations", "ablations.run"}
# Rows of params.yaml that one command runs, by the command's option.
ROWS = {"baseline": "method", "ablation": "variant"}
# The scenes that a stage runs for.
SCENES = {"animate": "animation.scenes", "ablation": "ablations.scenes"}

# Names of one command that runs for several lists of methods.
BASELINES = ("classical", "equal_time", "learned")

LISTED = {"classical": list(PARAMS.methods.classical)}
LISTED["equal_time"] = [m for m, o in PARAMS.baselines.items() if o.waits_for_field]
LISTED["learned"] = [m for m in PARAMS.baselines if not any(m in rows for rows in LISTED.values())]

# Of these lists no system learns from the field's targets.
WITHOUT_TARGETS = ("classical", "equal_time")

# Parameters that Workspace reads on the way, by the names that it reads them for.
BEHIND = {"film_size": "film", "sensor": "film"}


def pipeline() -> dict:
    return YAML(typ="safe").load((PROJECT / "dvc.yaml").read_text(encoding="utf-8"))


NAMES = list(pipeline()["stages"])
# All others depend on this one.
WITH_CODE = [name for name in NAMES if name != "code"]


def definition(stage: str) -> dict:
    """A stage as if it were for one scene."""
    found = pipeline()["stages"][stage]
    return found.get("do", found)


def needed_by(stage: str) -> set[str]:
    """The project's files that decide what a stage writes, for any of its methods."""
    if stage in BASELINES:
        rows = [files_of_baseline(PARAMS.baselines[method]) for method in LISTED[stage]]
        return set().union(*rows)
    if stage == "scene":
        return set().union(*(files_of_scene(scene) for scene in PARAMS.scenes))
    return set(files_of_stage(stage, PARAMS))


def stage_file(stage: str) -> str:
    return STAGES[command(stage)][0].replace(".", "/") + ".py"


def command(stage: str) -> str:
    return "baseline" if stage in BASELINES else stage


def covers(entries: list[str], file: str) -> bool:
    return any(file == entry or file.startswith(f"{entry}/") for entry in entries)


def deps(stage: str) -> list[str]:
    return [str(entry).replace("item.scene", "item") for entry in definition(stage)["deps"]]


def outs(stage: str, ran: Params = PARAMS) -> list[str]:
    do = definition(stage)
    entries = [*do.get("outs", []), *do.get("metrics", []), *do.get("plots", [])]
    names = [entry if isinstance(entry, str) else next(iter(entry)) for entry in entries]
    names = [name.replace("item.scene", "item") for name in names]
    if command(stage) not in ROWS:
        return names
    rows = getattr(ran.methods, stage) if stage in BASELINES else ran.ablations.run
    return [without_row(name, row) for name in names for row in rows]


def without_row(entry: str, row: str) -> str:
    return re.sub(r"\$\{item\.(method|variant)\}", row, entry)


def test_the_stages_are_those_of_the_command_line():
    assert list(dict.fromkeys(command(name) for name in NAMES)) == list(STAGES)
    for name, stage in pipeline()["stages"].items():
        scenes = f"${{{SCENES.get(name, 'scenes')}}}"
        if row := ROWS.get(command(name)):
            listed = f"methods.{name}" if name in BASELINES else "ablations.run"
            assert stage["matrix"] == {"scene": scenes, row: f"${{{listed}}}"}
            item = f"--go-on --scene ${{item.scene}} --{row} ${{item.{row}}}"
            assert stage["cmd"] == f"gpf stage {command(name)} {item}"
        elif name in OF_ALL_SCENES:
            assert stage["cmd"] == f"gpf stage {name}"
        else:
            assert stage["foreach"] == scenes
            assert stage["do"]["cmd"] == f"gpf stage {name} --scene ${{item}}"


@pytest.mark.parametrize("stage", WITH_CODE)
def test_every_stage_depends_on_what_its_code_says(stage):
    name = "baselines/${item.method}" if stage in BASELINES else stage
    name = "scenes/${item}" if stage == "scene" else name
    assert [entry for entry in deps(stage) if "/code/" in entry] == [f"results/code/{name}.txt"]
    assert not any(covers(list(PACKAGES), entry) for entry in deps(stage))


def test_what_the_code_says_depends_on_all_packages_and_builders():
    assert deps("code") == [*PACKAGES, "scenes"]


def read_params_of(file: str) -> set[str]:
    """Dotted parameters that a stage's file reads, as far as its text shows."""
    found = {"runtime"}
    for function in ast.walk(ast.parse((PROJECT / file).read_text(encoding="utf-8"))):
        if not isinstance(function, ast.FunctionDef):
            continue
        nodes = list(ast.walk(function))
        # `section = work.params.train` followed by section.steps reads train.steps.
        aliases = {
            node.targets[0].id: path
            for node in nodes
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
            for path in [params_path(node.value, {})]
            if path
        }
        attributes = [node for node in nodes if isinstance(node, ast.Attribute)]
        paths = {params_path(node, aliases) for node in attributes} - {None}
        found |= {path for path in paths if not any(p.startswith(f"{path}.") for p in paths)}
        found |= {BEHIND[node.attr] for node in attributes if node.attr in BEHIND}
    return found


def params_path(node: ast.AST, aliases: dict[str, str]) -> str | None:
    """``train.steps`` for ``work.params.train.steps``, also by way of a local name."""
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.insert(0, node.attr)
        node = node.value
    if not isinstance(node, ast.Name):
        return None
    if node.id in aliases:
        names = [*aliases[node.id].split("."), *names]
    elif "params" in names:
        names = names[names.index("params") + 1 :]
    else:
        return None
    kept: list[str] = []
    model = Params
    for name in names:
        if name not in getattr(model, "model_fields", {}):
            break
        kept.append(name)
        model = model.model_fields[name].annotation
    return ".".join(kept) or None


def params_of(stage: str) -> list[str] | None:
    """Declared parameters, rows by their section; None: all of params.yaml."""
    entries = definition(stage)["params"]
    if entries == [{"params.yaml": None}]:
        return None
    return [re.sub(r"\.\$\{item\.(method|variant)\}$", "", entry) for entry in entries]


@pytest.mark.parametrize("stage", WITH_CODE)
def test_every_parameter_that_a_stage_reads_is_declared(stage):
    declared = params_of(stage)
    if declared is None:  # all of them
        return
    # What Workspace reads is read by the names in BEHIND.
    own = needed_by(stage) - {"stages/common/workspace.py"}
    files = [stage_file(stage), *(file for file in own if file.startswith("stages/"))]
    reads = set().union(*(read_params_of(file) for file in files))
    assert "runtime" in reads
    missing = {
        path
        for path in reads - WHO_RENDERS
        if not any(path == entry or path.startswith(f"{entry}.") for entry in declared)
    }
    assert missing == set()


@pytest.mark.parametrize("stage", WITHOUT_TARGETS)
def test_systems_that_depend_on_the_fields_training_are_of_no_other_list(stage):
    assert not any(PARAMS.baselines[m].learns_from_targets for m in LISTED[stage])
    assert PARAMS.baselines["radiance_cache"].learns_from_targets


def test_the_reader_of_parameters_sees_them():
    assert "train.steps" in read_params_of("stages/training/settings.py")
    assert "field.anisotropic" in read_params_of("stages/training/settings.py")
    assert {"reference.surface_points", "film"} <= read_params_of("stages/references/groups.py")
    assert "reference.passes" in read_params_of("stages/amortize.py")


@pytest.mark.parametrize("stage", NAMES)
def test_declared_parameters_exist(stage):
    params = YAML(typ="safe").load((PROJECT / "params.yaml").read_text(encoding="utf-8"))
    for entry in params_of(stage) or []:
        place = params
        for part in entry.split("."):
            assert part in place, entry
            place = place[part]


def test_what_a_stage_takes_another_makes():
    made = [entry for stage in NAMES for entry in outs(stage)]
    for stage in NAMES:
        for entry in deps(stage):
            if entry.startswith("results/"):
                # What others make of it, or in it.
                within = any(covers([entry], path) for path in made)
                assert within or covers(made, entry), (stage, entry)
    assert len(made) == len(set(made))


def test_all_that_the_pipeline_writes_is_an_output(built):
    ran = read_params(built.folder / "params.yaml")
    names = [name for name in NAMES if command(name) in SMOKE_STAGES]
    made = [entry.replace("${item}", "cornell_box") for s in names for entry in outs(s, ran)]
    files = sorted(built.snapshot())
    assert [file for file in files if not covers(made, file)] == []
    idle = [entry for entry in made if not any(covers([entry], file) for file in files)]
    # A variant that is the field as it is has a folder with nothing in it.
    assert idle == ["results/cornell_box/ablations/all"] and (built.folder / idle[0]).is_dir()


def test_flicker_is_a_metric_of_each_scene_that_is_animated():
    """DVC has no loop over such entries."""
    listed = [f"results/{scene}/animation/flicker.json" for scene in PARAMS.animation.scenes]
    assert pipeline()["metrics"] == listed
    # Within an output of the stage, that is, and of no stage's metrics.
    assert "results/${item}/animation" in outs("animate")


def test_expensive_outputs_survive_a_rerun():
    """DVC deletes outputs before a stage runs, unless they say that they persist."""
    do = definition("reference")
    persist = {
        name
        for entry in do["outs"]
        if isinstance(entry, dict)
        for name, options in entry.items()
        if options.get("persist")
    }
    assert {f"results/${{item}}/{name}" for name in ("reference", "second_reference")} <= persist
