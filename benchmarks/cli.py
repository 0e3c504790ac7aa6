"""The command line of the programs, and the options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from gpf.cli import run_app
from gpf.core.runtime import choose_variant

KEPT = Path("results/benchmark_references")

Scenes = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[SCENE]…",
        help="Scenes of `scenes/`, of benchmarks/check_scenes.py or benchmarks/lit_scenes.py, or "
        "scene files.",
    ),
]
ProjectScenes = Annotated[
    list[str] | None, typer.Argument(metavar="[SCENE]…", help="Scenes of `scenes/`.")
]
Kept = Annotated[
    Path, typer.Option(metavar="FOLDER", help="Where images and fields are kept for the next run.")
]
Rows = Annotated[int, typer.Option(min=16, help="Rows of the pictures.")]
Samples = Annotated[int, typer.Option(min=5, help="Samples per pixel of the truth.")]
Seconds = Annotated[float, typer.Option(min=0, help="Seconds of the fit.")]
EachSeconds = Annotated[
    list[float] | None, typer.Option("--seconds", help="Seconds of a fit; may be repeated.")
]
EachPasses = Annotated[
    list[int] | None, typer.Option("--passes", help="Passes of a fit; may be repeated.")
]
ReferencePasses = Annotated[int, typer.Option(min=1, help="Passes of each SPPM image.")]


def goals(seconds: Sequence[float] | None, passes: Sequence[int] | None) -> list[dict[str, Any]]:
    """What :func:`gpf.fit` is asked for, one fit after another."""
    return [{"seconds": s} for s in seconds or ()] + [{"passes": n} for n in passes or ()]


def make_app(*commands: Callable[..., None]) -> typer.Typer:
    """A program with some commands; if it has only one, that needs no name."""
    app = typer.Typer(no_args_is_help=len(commands) > 1, pretty_exceptions_enable=False)
    for command in commands:
        app.command()(command)
    return app


def run(app: typer.Typer) -> None:
    """Run a program; an error that the user can correct is a message."""
    choose_variant()
    run_app(app)
