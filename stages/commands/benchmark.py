"""The commands of `gpf` that need a checkout of the project: `gpf stage NAME` and others."""

from __future__ import annotations

import importlib
from contextlib import nullcontext
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gpf.core.errors import UserError, is_interrupt
from gpf.core.locks import sole_run
from gpf.core.partial import remove_leftovers
from stages.common.makers import naming_commands

scene_app = typer.Typer(help="The scenes of the project.", no_args_is_help=True)

# Stage -> module and function; imported when called, so that each stage imports only what it needs.
STAGES = {
    "scene": ("stages.scene", "prepare_scene"),
    "reference": ("stages.reference", "render_references"),
    "photons": ("stages.photons", "trace"),
    "train": ("stages.train", "train_field"),
    "render": ("stages.render", "render_views"),
    "baseline": ("stages.baseline", "run_baselines"),
    "metrics": ("stages.metrics", "compare_images"),
    "ablation": ("stages.ablation", "run_ablations"),
    "animate": ("stages.animate", "animate"),
    "amortize": ("stages.amortize", "amortize"),
    "report": ("stages.report", "write_report"),
}
# Run once, for all scenes.
OF_ALL_SCENES = ("report",)
StageName = StrEnum("StageName", list(STAGES))  # type: ignore[misc]


def stage(
    name: Annotated[StageName, typer.Argument(help="The stage to run.")],
    scene: Annotated[
        str | None,
        typer.Option(help="The scene; every stage except `report` needs one."),
    ] = None,
    passes: Annotated[
        str | None,
        typer.Option(
            metavar="FIRST:LAST",
            help="For `reference`: only passes FIRST to LAST-1, counted from 0.",
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="For `baseline`: only this row of params.yaml."),
    ] = None,
    variant: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="For `ablation`: only this variant of params.yaml."),
    ] = None,
    go_on: Annotated[
        bool,
        typer.Option(
            "--go-on",
            help="For `baseline` and `ablation`: if one cannot run in the scene, save the reason; "
            "no error.",
        ),
    ] = False,
) -> None:
    """Run one stage of the pipeline for one scene; it reads the files of earlier stages."""
    given = {
        "scene": (tuple(s for s in STAGES if s not in OF_ALL_SCENES), scene),
        "passes": (("reference",), passes),
        "method": (("baseline",), method),
        "variant": (("ablation",), variant),
        "go_on": (("baseline", "ablation"), go_on or None),
    }
    options = {option: value for option, (_, value) in given.items() if value is not None}
    for option in options:
        if name.value not in given[option][0]:
            flag = "--go-on" if option == "go_on" else f"--{option} {options[option]}"
            raise UserError(flag, f"is not for {name.value}", "Leave it out.")
    if name.value not in OF_ALL_SCENES and "scene" not in options:
        raise UserError(f"stage {name.value}", "needs a scene", "Name it with --scene.")
    module, function = STAGES[name.value]
    options.pop("scene", None)
    folder, arguments = Path("results"), []
    if scene is not None:
        from gpf.scene.folders import scene_folder

        scene_folder(scene)  # says what is wrong before a lock is written
        folder, arguments = folder / scene, [scene]
    # Each row of params.yaml is an output of its own, and ranges of passes add up.
    rows = [row.replace("/", "_") for row in (method, variant) if row]
    output = folder / "-".join([name.value, *rows])
    from gpf.scene.untraceable import telling_untraceable

    # Others run foreign programs, whose errors say nothing about the scene.
    traces = name.value in ("reference", "photons", "train", "render")
    telling = telling_untraceable(f"scene {scene!r}") if traces else nullcontext()
    try:
        with sole_run(output, shared=passes is not None), telling:
            remove_leftovers(folder, deep=True)
            remove_leftovers(Path("results/costs"))  # which all scenes share
            getattr(importlib.import_module(module), function)(*arguments, **options)
    except BaseException as error:  # not in main, because typer catches interrupts itself
        if not is_interrupt(error):
            raise
        typer.echo("\nstopped; run it again to continue", err=True)
        raise typer.Exit(130) from None


def profile(
    name: Annotated[str, typer.Argument(help="quick, desk, full, paper or smoke.")],
) -> None:
    """Write the sizes of a profile into params.yaml, and print what changed."""
    from stages.commands.profiles import apply_profile

    apply_profile(name)


@scene_app.command("list")
def list_all() -> None:
    """List the scenes, with their numbers of views, and whether params.yaml lists them."""
    from stages.commands.scene_list import print_scenes

    print_scenes()


@scene_app.command("preview")
def preview(
    name: Annotated[str, typer.Argument(help="The scene.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="A PNG; default: in results/NAME.")
    ] = None,
    height: Annotated[int, typer.Option(min=16, max=1024, help="Rows of each picture.")] = 96,
    passes: Annotated[int, typer.Option(min=1, help="SPPM passes.")] = 8,
    everything: Annotated[
        bool, typer.Option("--all", help="All training views and all frames of the path.")
    ] = False,
) -> None:
    """Render small pictures of the views, path tracer and SPPM side by side, and list faults."""
    from stages.commands.preview import preview_scene

    preview_scene(name, out, height, passes, everything)


@scene_app.command("import")
def import_foreign(
    path: Annotated[
        Path, typer.Argument(help="An XML file, or a folder or zip archive that contains one.")
    ],
    name: Annotated[str, typer.Option(help="The scene's name in the project.")],
) -> None:
    """Copy a Mitsuba 3 scene into the project, print a report, and place views in the scene."""
    from stages.commands.scene_import import import_into_project

    import_into_project(path, name)


def add_to(app: typer.Typer) -> None:
    """Add these commands to `gpf`."""
    for command in (stage, profile):
        app.command()(naming_commands(command))
    app.add_typer(scene_app, name="scene")
