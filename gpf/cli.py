"""The command `gpf`: the library's commands and, in a checkout of the project, the pipeline's."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from gpf.core.checkout import CHECKOUT
from gpf.core.errors import UserError, explain_file_error, is_interrupt, no_lost_interrupts
from gpf.core.progress import console, show_log
from gpf.core.runtime import VARIANT, VARIANTS

app = typer.Typer(
    help="Gaussian photon fields: trace photons once, render any number of views.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # with "rich", text in brackets would vanish
)

SCENE = "A scene file, a folder with one, or the name of a scene in results/."

Scene = Annotated[str, typer.Argument(metavar="SCENE", help=SCENE)]
Field = Annotated[
    str, typer.Argument(metavar="FIELD", help="A field's file, or the name of a trained scene.")
]
FieldFile = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="The field. [default: field.safetensors]"),
]
Views = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Cameras: views.yaml or transforms.json. [default: views.yaml beside the scene]",
    ),
]
Groups = Annotated[
    str,
    typer.Option(
        metavar="auto|FILE",
        help="Keep the light of emitters apart, to dim and colour it later: of each one, or of "
        "the groups in a YAML file such as `window: [sky]`.",
    ),
]
ChangedScene = Annotated[
    bool, typer.Option("--changed-scene", help="Render even if the scene changed since the fit.")
]


def print_version(wanted: bool) -> None:
    """Print the version and stop."""
    if wanted:
        from gpf import __version__

        print(f"gpf {__version__}")
        raise typer.Exit


@app.callback()
def set_up(
    version: Annotated[
        bool,
        typer.Option("--version", callback=print_version, is_eager=True, help="Show the version."),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="No progress bars or messages, only errors.")
    ] = False,
    variant: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            envvar=VARIANT,
            help=f"Mitsuba variant: {', '.join(VARIANTS)}. [default: the GPU's, if there is one]",
        ),
    ] = None,
) -> None:
    """Apply the options of all commands."""
    console.quiet = quiet
    if variant is not None:
        os.environ[VARIANT] = variant  # processes that this one starts use it, too


@app.command()
def demo(
    folder: Annotated[Path, typer.Argument(help="A new folder.")] = Path("gpf-demo"),
) -> None:
    """Fit a field to a pool of water in some 20 seconds, and render pictures from it."""
    from gpf.commands.demo import run_demo

    run_demo(folder)


@app.command()
def export(
    field: Field,
    ply: Annotated[
        Path | None,
        typer.Option(metavar="OUT.ply", help="Write splats, for viewers of 3D Gaussian splats."),
    ] = None,
    compact: Annotated[
        Path | None,
        typer.Option(metavar="OUT.safetensors", help="Write a field of a third of the size."),
    ] = None,
    exposure: Annotated[
        float | None,
        typer.Option(help="Exposure of --ply. [default: from views.yaml or the field]"),
    ] = None,
) -> None:
    """Write a field as 3D Gaussian splats, or in a third of its size."""
    from gpf.commands.export import export_field

    export_field(field, ply, compact, exposure)


@app.command()
def fit(
    scene: Scene,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT.safetensors",
            help="The field's file. [default: field.safetensors]",
        ),
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Time limit of the fit.")] = None,
    target_psnr: Annotated[
        float | None, typer.Option(metavar="DB", help="Stop at this estimated PSNR of the images.")
    ] = None,
    passes: Annotated[
        int | None, typer.Option(help="Photon passes. [default without other goals: 300]")
    ] = None,
    views: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Cameras that the field is for: views.yaml or transforms.json. [default: "
            "views.yaml beside the scene; without it, cameras are placed in the scene]",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
    go_on: Annotated[
        Path | None,
        typer.Option(
            "--continue",
            metavar="FIELD.safetensors",
            help="Continue a finished fit with more photons; replaces the field.",
        ),
    ] = None,
    groups: Groups = "",
) -> None:
    """Fit a field to a scene.

    Stops when the first of --seconds, --target-psnr and --passes is reached. OUT.png shows the
    progress. If the fit was killed, the same command resumes it.
    """
    from gpf.commands.fit import fit_scene_file

    if go_on is not None and output is not None:
        raise UserError(
            "--continue and --output", "are mutually exclusive", "Copy the field first."
        )
    out = go_on or output or Path("field.safetensors")
    fit_scene_file(scene, out, seconds, target_psnr, passes, views, seed, go_on is not None, groups)


@app.command()
def render(
    scene: Scene,
    field: FieldFile = None,
    view: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A camera by name. Repeat it for several."),
    ] = None,
    views: Views = None,
    frames: Annotated[
        str | None,
        typer.Option(
            metavar="all|FIRST:LAST",
            help="Frames of the camera path in views.yaml: all, or FIRST to LAST-1, from 0.",
        ),
    ] = None,
    orbit: Annotated[
        int,
        typer.Option(
            metavar="N", min=0, max=100_000, help="N cameras around what the scene's camera sees."
        ),
    ] = 0,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="[default: pictures]"),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Such as 512x512, or the rows alone. [default: 256]"),
    ] = None,
    spp: Annotated[
        int | None,
        typer.Option(min=1, max=1_000_000, help="Camera samples per pixel. [default: 64]"),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Time for each picture, instead of --spp.")
    ] = None,
    aovs: Annotated[
        str,
        typer.Option(
            metavar="LIST",
            help="More layers, separated by commas: depth, position, normal, albedo, "
            "visible_normal, irradiance, coverage, error.",
        ),
    ] = "",
    exposure: Annotated[float | None, typer.Option(help="Exposure of the PNG files.")] = None,
    denoise: Annotated[
        bool | None,
        typer.Option(
            "--denoise/--no-denoise",
            help="Use Open Image Denoise where noise is visible. [default: if pyoidn is installed]",
        ),
    ] = None,
    mp4: Annotated[bool, typer.Option("--mp4", help="Also write all pictures as a film.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
    changed_scene: ChangedScene = False,
    executor: Annotated[
        Literal["local", "ray"],
        typer.Option(help="ray: spread the pictures over the machines of a cluster."),
    ] = "local",
    cluster: Annotated[
        str,
        typer.Option(
            metavar="HOST:PORT", help="A Ray cluster. [default: start one on this machine]"
        ),
    ] = "",
    lights: Annotated[
        str,
        typer.Option(
            metavar="LEVELS",
            help="Brightness of a field's groups of lights: `window=0.2,lamp=1.5,#ffd0a0`.",
        ),
    ] = "",
) -> None:
    """Render views of a scene from a field. Existing pictures of the same kind are kept."""
    from gpf.commands.cameras import CameraChoice
    from gpf.commands.render import PictureOptions, render_pictures

    choice = CameraChoice(tuple(view or ()), views, frames, orbit)
    options = PictureOptions(
        size=size,
        spp=spp,
        seconds=seconds,
        aovs=aovs,
        exposure=exposure,
        denoise=denoise,
        film=mp4,
        seed=seed,
        changed_scene=changed_scene,
        executor=executor,
        cluster=cluster,
        lights=lights,
    )
    render_pictures(scene, field, choice, output, options)


@app.command()
def lights(field: Field) -> None:
    """List the groups of lights in a field."""
    from gpf.commands.lights import list_lights

    list_lights(field)


@app.command()
def view(
    scene: Scene,
    field: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The field. [default: --output if it exists; else one is fitted meanwhile]",
        ),
    ] = None,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="OUT.safetensors", help="Where to save that field."),
    ] = Path("field.safetensors"),
    views: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Cameras to jump to; new ones are saved there. [default: views.yaml]",
        ),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address to serve on; only this machine can reach the default.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port to serve on; 0: any free one.")
    ] = 0,
    opens: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page in a browser.")
    ] = True,
    changed_scene: ChangedScene = False,
    groups: Groups = "",
) -> None:
    """Explore a scene in the browser; the picture improves as photons arrive."""
    from gpf.commands.view import ServerOptions, view_scene

    server = ServerOptions(host, port, opens)
    view_scene(scene, field, output, views, server, changed_scene, groups)


@app.command()
def mitsuba(
    scene: Scene,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="[default: the scene's name, .exr]"),
    ] = None,
    define: Annotated[
        list[str] | None,
        typer.Option("--define", "-D", metavar="NAME=VALUE", help="A parameter of the scene."),
    ] = None,
    sensor: Annotated[int, typer.Option("--sensor", "-s", help="Index of the sensor.")] = 0,
    spp: Annotated[
        int, typer.Option(min=0, max=1_000_000, help="Samples per pixel; 0: as in the scene.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Random seed.")] = 0,
) -> None:
    """Render a scene with its own integrator, which may be sppm or gpf.

    Mitsuba's own command does not find plugins that are written in Python.
    """
    from gpf.commands.mitsuba import render_scene

    render_scene(scene, output, define or [], sensor, spp, seed)


@app.command()
def doctor() -> None:
    """Check this machine, and explain how to repair what is missing."""
    from gpf.doctor import diagnose, print_report

    raise typer.Exit(print_report(diagnose()))


if CHECKOUT is not None:
    importlib.import_module("stages.commands.benchmark").add_to(app)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    run_app(app, arguments)


def run_app(commands: typer.Typer, arguments: Sequence[str] | None = None) -> None:
    """Run commands; an error that the user can correct is a message and exit code 2."""
    show_log()
    with no_lost_interrupts():
        try:
            commands(args=list(sys.argv[1:] if arguments is None else arguments))
        except (UserError, OSError) as error:
            told = error if isinstance(error, UserError) else explain_file_error(error)
            if told is None:
                raise
            typer.secho(f"error: {told}", fg="red", err=True)
            sys.exit(UserError.exit_code)
        except Exception as error:
            if not is_interrupt(error):  # typer knows only a plain one
                raise
            typer.echo("\nstopped", err=True)
            sys.exit(130)


if __name__ == "__main__":
    main()
