"""dvc.yaml declares what the stages really depend on: modules, parameters and files."""

from __future__ import annotations

import re
from functools import cache

import pytest
from ruamel.yaml import YAML

from stages.commands.profiles import read_profiles
from stages.commands.stage import OF_ALL_SCENES, STAGES
from stages.common.code import code_of
from stages.config.params import Params, read_params
from tests.stages.imports import PROJECT, files_behind
from tests.stages.params_read import params_read_by
from tests.stages.results import SMOKE_STAGES

PARAMS = read_params(PROJECT / "params.yaml")
# Who renders a pass changes no bit of it; DVC calls `baseline` for each method by itself, and
# `ablation` for each variant.
WHO_RENDERS = {"executor", "methods", "ablations", "ablations.run"}
# Rows of params.yaml that one command runs, by the command's option.
ROWS = {"baseline": "method", "ablation": "variant"}
# The scenes that a stage runs for.
SCENES = {"animate": "animation.scenes", "ablation": "ablations.scenes"}

# `gpf stage` of the folder in which DVC works, not of the one that is installed.
CALL = "python -m gpf.cli stage"

# Names of one command that runs for several lists of methods.
BASELINES = ("classical", "equal_time", "learned")


def in_any_profile(key: str) -> list[str]:
    """What the profiles list under a key of params.yaml."""
    return sorted({name for profile in read_profiles().values() for name in profile[key]})


LISTED = {"classical": in_any_profile("methods.classical")}
LISTED["equal_time"] = [m for m, o in PARAMS.baselines.items() if o.waits_for_field]
LISTED["learned"] = [m for m in PARAMS.baselines if not any(m in rows for rows in LISTED.values())]

# Of these lists no system learns from the field's targets.
WITHOUT_TARGETS = ("classical", "equal_time")


@cache
def pipeline() -> dict:
    return YAML(typ="safe").load((PROJECT / "dvc.yaml").read_text(encoding="utf-8"))


NAMES = list(pipeline()["stages"])


def definition(stage: str) -> dict:
    """A stage as if it were for one scene."""
    found = pipeline()["stages"][stage]
    return found.get("do", found)


def needed_by(stage: str) -> set[str]:
    """The project's files that decide what a stage writes, for any of its methods."""
    starts = [stage_file(stage)]
    if stage in BASELINES:
        starts += [system_file(method) for method in LISTED[stage]]
    if stage == "animate":
        shown = in_any_profile("animation.methods")
        starts += [system_file(method) for method in shown if method in PARAMS.baselines]
    if stage == "scene":  # which lists each scene's folder, with the builder
        builders = [p.relative_to(PROJECT).as_posix() for p in PROJECT.glob("scenes/*/build.py")]
        return files_behind([*starts, *builders]) - set(builders)
    return files_behind(starts)


def system_file(method: str) -> str:
    """The file of a method's system, which :mod:`baselines.registry` imports by name."""
    place = f"baselines/{PARAMS.baselines[method].system}"
    return f"{place}/baseline.py" if (PROJECT / place).is_dir() else f"{place}.py"


def stage_file(stage: str) -> str:
    return f"stages/{command(stage)}.py"


def command(stage: str) -> str:
    return "baseline" if stage in BASELINES else stage


def covers(entries: list[str], file: str) -> bool:
    return any(file == entry or file.startswith(f"{entry}/") for entry in entries)


def deps(stage: str) -> list[str]:
    return [entry.replace("item.scene", "item") for entry in definition(stage)["deps"]]


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
            assert stage["cmd"] == f"{CALL} {command(name)} {item}"
        elif name in OF_ALL_SCENES:
            assert stage["cmd"] == f"{CALL} {name}"
        else:
            assert stage["foreach"] == scenes
            assert stage["do"]["cmd"] == f"{CALL} {name} --scene ${{item}}"


@pytest.mark.parametrize("stage", NAMES)
def test_every_stage_lists_the_code_that_it_imports(stage):
    assert {file for file in needed_by(stage) if not covers(deps(stage), file)} == set()


@pytest.mark.parametrize("stage", NAMES)
def test_the_code_that_a_stage_lists_exists(stage):
    listed = [entry for entry in deps(stage) if "$" not in entry and entry != "results/costs"]
    assert [entry for entry in listed if not (PROJECT / entry).exists()] == []
    files = [path.relative_to(PROJECT).as_posix() for path in code_of(stage)]
    assert files and all(covers(listed, file) and file.endswith(".py") for file in files)


def test_the_reader_of_imports_sees_them():
    render = files_behind(["stages/render.py"])
    assert {"gpf/rendering/gpf.py", "gpf/field/field.py", "gpf/core/spatial_hash.py"} <= render
    assert not any(file.startswith(("stages/config", "gpf/guiding")) for file in render)
    assert "gpf/guiding/pilot.py" in files_behind(["stages/photons.py"])
    assert "gpf/sppm/passes.py" in files_behind(["baselines/sppm.py"])
    # Inside a function.
    assert "stages/references/cluster.py" in files_behind(["stages/reference.py"])
    assert "scenes/modelling/teapot.py" in needed_by("scene")


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
    # The effort of the field is for systems that learn from its targets.
    unused = ["effort"] if stage in WITHOUT_TARGETS else []
    reads = params_read_by(stage_file(stage), "run", unused)
    assert "runtime" in reads
    known = [*declared, "cluster", "progress"]  # change no result
    missing = {
        path
        for path in reads - WHO_RENDERS
        if not any(path == entry or path.startswith(f"{entry}.") for entry in known)
    }
    assert missing == set()


@pytest.mark.parametrize("stage", WITHOUT_TARGETS)
def test_systems_that_depend_on_the_fields_training_are_of_no_other_list(stage):
    assert not any(PARAMS.baselines[m].learns_from_targets for m in LISTED[stage])
    assert PARAMS.baselines["radiance_cache"].learns_from_targets


def test_the_reader_of_parameters_sees_them():
    train = params_read_by("stages/train.py", "run")
    assert {"stream.passes", "progress.checkpoint_seconds", "reference.rr_depth"} <= train
    assert not any(path.startswith("photons") for path in train)  # of which one function is used
    assert "photons.paths" in params_read_by("stages/photons.py", "run")
    reference = params_read_by("stages/reference.py", "run")
    assert {"reference.surface_points", "film", "cluster.workers"} <= reference
    assert "reference.passes" in params_read_by("stages/amortize.py", "run")


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
