"""dvc.yaml declares what the stages really depend on: modules, parameters and files."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from gpf.config import Params, read_params
from stages.cli import OF_ALL_SCENES, STAGES
from tests.stages.results import SMOKE_STAGES

PROJECT = Path(__file__).parent.parent.parent
PARAMS = read_params(PROJECT / "params.yaml")
PACKAGES = ("gpf", "stages", "metrics", "report")

# Whose change cannot change what a stage writes: they start things up, complain or report.
NO_INFLUENCE = {
    "gpf/__init__.py",
    "gpf/config.py",
    "gpf/config_sections.py",
    "gpf/errors.py",
    "gpf/integrators/__init__.py",
    "gpf/runtime.py",
    "gpf/yaml_files.py",
    "metrics/__init__.py",
    "metrics/errors.py",
    "report/__init__.py",
    "stages/__init__.py",
    "stages/apart.py",
    "stages/cluster.py",
    "stages/progress.py",
}
# Who renders a pass changes no bit of it; DVC calls `baseline` for each method by itself, and
# `ablation` for each variant.
WHO_RENDERS = {"executor", "cluster", "methods", "ablations", "ablations.run"}
# Rows of params.yaml that one command runs, by the command's option.
ROWS = {"baseline": "method", "ablation": "variant"}
# The scenes that a stage runs for.
SCENES = {"animate": "animation.scenes", "ablation": "ablations.scenes"}

# Names of one command that runs for several lists of methods.
BASELINES = ("classical", "equal_time", "learned")

# Loaded by name, where no import tells.
LISTED = {"classical": list(PARAMS.methods.classical)}
LISTED["equal_time"] = [m for m, o in PARAMS.baselines.items() if o.waits_for_field]
LISTED["learned"] = [m for m in PARAMS.baselines if not any(m in rows for rows in LISTED.values())]
SYSTEMS = {
    stage: [f"gpf/baselines/{PARAMS.baselines[method].system}.py" for method in methods]
    for stage, methods in LISTED.items()
}
# Any row may be animated.
ANIMATED = {options.system for options in PARAMS.baselines.values()}
LOADED = {
    "render": ["gpf/integrators/gpf.py"],
    "metrics": ["metrics/image.py"],
    "ablation": ["gpf/integrators/gpf.py", "metrics/image.py"],
    "animate": ["gpf/integrators/gpf.py", *(f"gpf/baselines/{s}.py" for s in sorted(ANIMATED))],
    **SYSTEMS,
}

# Imported for systems that learn from the field's targets: of these lists none does.
FOR_TARGETS = "stages/field_effort.py"
WITHOUT_TARGETS = ("classical", "equal_time")

# Parameters that Workspace reads on the way, by the names that it reads them for.
BEHIND = {"film_size": "film", "sensor": "film"}
# Properties of a section, by the parameters that they read.
OF_SECTION = {"most_gaussians": "gaussians"}
# Run, not imported.
PROGRAMS = "gpf/baselines/programs"


def pipeline() -> dict:
    return YAML(typ="safe").load((PROJECT / "dvc.yaml").read_text(encoding="utf-8"))


NAMES = list(pipeline()["stages"])


def definition(stage: str) -> dict:
    """A stage as if it were for one scene."""
    found = pipeline()["stages"][stage]
    return found.get("do", found)


@functools.cache
def imports_of(file: str) -> frozenset[str]:
    """Files of the project that one of its files imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse((PROJECT / file).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module is not None, "relative import"
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        for name in names:
            parts = name.split(".")
            if parts[0] in PACKAGES:
                for end in range(1, len(parts) + 1):
                    place = "/".join(parts[:end])
                    found |= {
                        f for f in (f"{place}.py", f"{place}/__init__.py") if (PROJECT / f).exists()
                    }
    return frozenset(found)


def closure(*files: str) -> set[str]:
    """The files and all that they import, directly or not, but for those without influence."""
    done: set[str] = set()
    waiting = list(files)
    while waiting:
        file = waiting.pop()
        if file not in done:
            done.add(file)
            # What has no influence passes none on.
            waiting += [] if file in NO_INFLUENCE else imports_of(file)
    return done - NO_INFLUENCE


def needed_by(stage: str) -> set[str]:
    """All that a stage imports; builders of scenes are loaded by their path."""
    loaded = set(LOADED.get(stage, []))
    if stage == "scene":
        for builder in sorted(PROJECT.glob("scenes/*/build.py")):
            loaded |= imports_of(builder.relative_to(PROJECT).as_posix())
    needed = closure(stage_file(stage), *loaded)
    return needed - {FOR_TARGETS} if stage in WITHOUT_TARGETS else needed


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


@pytest.mark.parametrize("stage", NAMES)
def test_every_module_that_a_stage_imports_is_a_dependency(stage):
    needed = needed_by(stage)
    missing = sorted(file for file in needed if not covers(deps(stage), file))
    assert missing == []


@pytest.mark.parametrize("stage", NAMES)
def test_no_dependency_is_without_reason(stage):
    """What a stage does not import should not make it run again."""
    needed = needed_by(stage)
    files = [entry for entry in deps(stage) if entry.split("/")[0] in PACKAGES]
    assert all((PROJECT / entry).exists() for entry in files)
    idle = [e for e in files if not any(covers([e], f) for f in needed) and e != PROGRAMS]
    assert idle == []


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
    for name in (OF_SECTION.get(name, name) for name in names):
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


@pytest.mark.parametrize("stage", NAMES)
def test_every_parameter_that_a_stage_reads_is_declared(stage):
    declared = params_of(stage)
    if declared is None:  # all of them
        return
    # What Workspace reads is read by the names in BEHIND.
    own = needed_by(stage) - {"stages/workspace.py"}
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
    assert "train.steps" in read_params_of("stages/train_settings.py")
    assert "field.anisotropic" in read_params_of("stages/train_settings.py")
    assert {"reference.surface_points", "film"} <= read_params_of("stages/groups.py")
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
    assert {f"results/${{item}}/{name}" for name in ("reference", "ceiling")} <= persist
