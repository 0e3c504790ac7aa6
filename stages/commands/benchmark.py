"""The commands of `gpf` that need a checkout of the project: `gpf stage NAME` and others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stages.commands.stage import app as stage_app

scene_app = typer.Typer(help="The scenes of the project.", no_args_is_help=True)


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
        Path | None,
        typer.Option("--output", "-o", metavar="FILE.png", help="[default: in results/NAME]"),
    ] = None,
    height: Annotated[int, typer.Option(min=16, max=1024, help="Picture height, pixels.")] = 96,
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
    app.command()(profile)
    app.add_typer(stage_app, name="stage")
    app.add_typer(scene_app, name="scene")
