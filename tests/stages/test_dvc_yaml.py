"""dvc.yaml declares what the stages really depend on: modules, parameters and files."""

from __future__ import annotations

import ast
import functools
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from gpf.config import Methods, Params, read_params
from stages.cli import STAGES

PROJECT = Path(__file__).parent.parent.parent
PARAMS = read_params(PROJECT / "params.yaml")
PACKAGES = ("gpf", "stages", "metrics")

# Whose change cannot change what a stage writes: they start things up, complain or report.
NO_INFLUENCE = {
    "gpf/__init__.py",
    "gpf/config.py",
    "gpf/errors.py",
    "gpf/integrators/__init__.py",
    "gpf/runtime.py",
    "gpf/yaml_files.py",
    "metrics/__init__.py",
    "metrics/errors.py",
    "stages/__init__.py",
    "stages/cluster.py",
    "stages/progress.py",
}
# Who renders a pass changes no bit of it; DVC calls `baseline` for each method by itself.
WHO_RENDERS = {"executor", "cluster", "methods"}

# Names of one command that runs for several lists of methods.
BASELINES = ("classical", "equal_time", "learned")

# Loaded by name, where no import tells.
LISTED = {"classical": PARAMS.methods.classical, "equal_time": PARAMS.methods.equal_time}
LISTED["learned"] = [m for m in PARAMS.baselines if not any(m in rows for rows in LISTED.values())]
SYSTEMS = {
    stage: [f"gpf/baselines/{PARAMS.baselines[method].system}.py" for method in methods]
    for stage, methods in LISTED.items()
}
LOADED = {
    "render": ["gpf/integrators/gpf.py"],
    "metrics": ["metrics/image.py"],
    **SYSTEMS,
}

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
    return closure(stage_file(stage), *loaded)


def stage_file(stage: str) -> str:
    command = "baseline" if stage in BASELINES else stage
    return STAGES[command][0].replace(".", "/") + ".py"


def covers(entries: list[str], file: str) -> bool:
    return any(file == entry or file.startswith(f"{entry}/") for entry in entries)


def deps(stage: str) -> list[str]:
    return [str(entry).replace("item.scene", "item") for entry in definition(stage)["deps"]]


def outs(stage: str, ran: Methods = PARAMS.methods) -> list[str]:
    do = definition(stage)
    entries = [*do.get("outs", []), *do.get("metrics", []), *do.get("plots", [])]
    names = [entry if isinstance(entry, str) else next(iter(entry)) for entry in entries]
    names = [name.replace("item.scene", "item") for name in names]
    if stage not in BASELINES:
        return names
    methods = getattr(ran, stage)
    return [name.replace("${item.method}", method) for name in names for method in methods]


def test_the_stages_are_those_of_the_command_line():
    commands = ["baseline" if name in BASELINES else name for name in NAMES]
    assert list(dict.fromkeys(commands)) == list(STAGES)
    for name, stage in pipeline()["stages"].items():
        if name in BASELINES:
            assert stage["matrix"] == {"scene": "${scenes}", "method": f"${{methods.{name}}}"}
            item = "--go-on --scene ${item.scene} --method ${item.method}"
            assert stage["cmd"] == f"gpf stage baseline {item}"
        else:
            assert stage["foreach"] == "${scenes}"
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


@pytest.mark.parametrize("stage", NAMES)
def test_every_parameter_that_a_stage_reads_is_declared(stage):
    declared = [entry.removesuffix(".${item.method}") for entry in definition(stage)["params"]]
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


def test_the_reader_of_parameters_sees_them():
    assert "train.steps" in read_params_of("stages/train_settings.py")
    assert "field.anisotropic" in read_params_of("stages/train_settings.py")
    assert {"reference.surface_points", "film"} <= read_params_of("stages/groups.py")
    assert "reference.passes" in read_params_of("stages/metrics.py")


@pytest.mark.parametrize("stage", NAMES)
def test_declared_parameters_exist(stage):
    params = YAML(typ="safe").load((PROJECT / "params.yaml").read_text(encoding="utf-8"))
    for entry in definition(stage)["params"]:
        entry = entry.removesuffix(".${item.method}")
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
    ran = read_params(built.folder / "params.yaml").methods
    made = [entry.replace("${item}", "cornell_box") for s in NAMES for entry in outs(s, ran)]
    files = sorted(built.snapshot())
    assert [file for file in files if not covers(made, file)] == []
    assert [entry for entry in made if not any(covers([entry], file) for file in files)] == []


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
