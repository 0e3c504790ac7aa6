"""`gpf stage NAME`: a command for each stage of the pipeline."""

from __future__ import annotations

import importlib
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from gpf.core.errors import is_interrupt
from gpf.core.locks import sole_run
from gpf.core.partial import remove_leftovers
from stages.common.makers import naming_commands

app = typer.Typer(
    help="Run one stage of the pipeline; it reads the files of earlier stages.",
    no_args_is_help=True,
)

# Stages that trace light in the scene itself. Others run foreign programs, whose errors say nothing
# about the scene.
TRACING = ("reference", "photons", "train", "render")

Scene = Annotated[str, typer.Option(metavar="NAME", help="A scene of the project.")]
GoOn = Annotated[
    bool,
    typer.Option("--go-on", help="If a row cannot run in the scene, save why and do not fail."),
]


def example(options: str) -> str:
    """The last line of a command's help."""
    return f"Example: gpf stage {options}"


@app.command(epilog=example("scene --scene veach_ajar"))
def scene(scene: Scene) -> None:
    """Build a scene, check it, and copy it to results/NAME/scene."""
    run_stage("scene", scene)


@app.command(epilog=example("reference --scene veach_ajar --passes 0:100"))
def reference(
    scene: Scene,
    passes: Annotated[
        str | None,
        typer.Option(
            metavar="FIRST:LAST",
            help="Only passes FIRST to LAST-1, counted from 0. Other machines trace the rest.",
        ),
    ] = None,
) -> None:
    """Render the SPPM references and the training targets."""
    run_stage("reference", scene, shared=passes is not None, passes=passes)


@app.command(epilog=example("photons --scene veach_ajar"))
def photons(scene: Scene) -> None:
    """Trace the photons that become Gaussians."""
    run_stage("photons", scene)


@app.command(epilog=example("train --scene veach_ajar"))
def train(scene: Scene) -> None:
    """Fit the field to the targets."""
    run_stage("train", scene)


@app.command(epilog=example("render --scene veach_ajar"))
def render(scene: Scene) -> None:
    """Render the novel views from the field."""
    run_stage("render", scene)


@app.command(epilog=example("baseline --scene veach_ajar --method path_50"))
def baseline(
    scene: Scene,
    method: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Only this row of `baselines` in params.yaml."),
    ] = None,
    go_on: GoOn = False,
) -> None:
    """Render the novel views with other systems."""
    run_stage("baseline", scene, row=method, method=method, go_on=go_on)


@app.command(epilog=example("metrics --scene veach_ajar"))
def metrics(scene: Scene) -> None:
    """Compare all images with the references."""
    run_stage("metrics", scene)


@app.command(epilog=example("ablation --scene veach_ajar --variant k_1"))
def ablation(
    scene: Scene,
    variant: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Only this row of `ablations` in params.yaml."),
    ] = None,
    go_on: GoOn = False,
) -> None:
    """Train and evaluate variants of the field."""
    run_stage("ablation", scene, row=variant, variant=variant, go_on=go_on)


@app.command(epilog=example("animate --scene veach_ajar"))
def animate(scene: Scene) -> None:
    """Render the camera path, make films of it, and measure their flicker."""
    run_stage("animate", scene)


@app.command(epilog=example("amortize --scene veach_ajar"))
def amortize(scene: Scene) -> None:
    """Find the number of views from which the field is cheaper."""
    run_stage("amortize", scene)


@app.command(epilog=example("report"))
def report() -> None:
    """Write the tables, the figures and the report of all scenes."""
    run_stage("report")


STAGES = tuple(command.callback.__name__ for command in app.registered_commands if command.callback)
"""Names of all stages, in the order of the pipeline; ``stages.NAME.run`` does the work."""

OF_ALL_SCENES = ("report",)


def run_stage(
    name: str,
    scene: str | None = None,
    *,
    row: str | None = None,
    shared: bool = False,
    **options: Any,
) -> None:
    """Run a stage; no other run may write the same output meanwhile.

    Parameters
    ----------
    row: a row of params.yaml; each row has its own output.
    shared: whether other runs may add to the output at the same time.
    options: arguments of the stage's ``run``.
    """
    folder, arguments = Path("results"), []
    if scene is not None:
        from gpf.scene.folders import scene_folder

        scene_folder(scene)  # reports errors before a lock is written
        folder, arguments = folder / scene, [scene]
    from gpf.scene.untraceable import telling_untraceable

    output = folder / (f"{name}-{row.replace('/', '_')}" if row else name)
    telling = telling_untraceable(f"scene {scene!r}") if name in TRACING else nullcontext()
    try:
        with naming_commands(), sole_run(output, shared), telling:
            remove_leftovers(folder, deep=True)
            remove_leftovers(Path("results/costs"))  # which all scenes share
            importlib.import_module(f"stages.{name}").run(*arguments, **options)
    except BaseException as error:  # not in main, because typer catches interrupts itself
        if not is_interrupt(error):
            raise
        typer.echo("\nstopped; run it again to continue", err=True)
        raise typer.Exit(130) from None
