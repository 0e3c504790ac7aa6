"""The command `gpf`: the library's commands and, in a checkout of the project, the pipeline's."""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from gpf.commands import options
from gpf.commands.bake_options import BakeOptions
from gpf.commands.picture_options import PictureOptions
from gpf.core.checkout import CHECKOUT
from gpf.core.cluster import ClusterChoice
from gpf.core.errors import UserError, explain_file_error, is_interrupt, no_lost_interrupts
from gpf.core.progress import console, show_log
from gpf.core.runtime import VARIANT, VARIANTS

app = typer.Typer(
    help="Gaussian photon fields: trace photons once, render any number of views.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # with "rich", text in brackets would vanish
)


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
        bool,
        typer.Option("--quiet", "-q", help="No progress bars or messages, only errors."),
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


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose last parameter, a dataclass, is replaced by an option for each field."""
    *own, group = inspect.signature(command, eval_str=True).parameters.values()
    types = get_type_hints(group.annotation, include_extras=True)
    defaults = {field.name: field.default for field in fields(group.annotation)}
    more = [group.replace(name=n, default=d, annotation=types[n]) for n, d in defaults.items()]

    @wraps(command)
    def run(**given: Any) -> None:
        asked = group.annotation(**{name: given.pop(name) for name in defaults})
        command(**given, **{group.name: asked})

    run.__signature__ = inspect.Signature([*own, *more])  # type: ignore[attr-defined]
    return run


@app.command()
@with_options
def bake(
    scene: options.Scene,
    field: options.FieldOfScene = None,
    output: options.BakeFolder = Path("baked"),
    *,
    asked: BakeOptions,
) -> None:
    """Bake the light of a field into maps or vertex colours, for engines and pages.

    Writes light maps (EXR, PNG), a mesh per shape with light-map coordinates (PLY), and index.json;
    on request, the whole scene as glTF, as a web page, or for Blender.
    """
    from gpf.commands.bake import bake_light

    bake_light(scene, field, output, asked)


@app.command()
def demo(folder: options.NewFolder = Path("gpf-demo")) -> None:
    """Fit a field to a pool of water in some 20 seconds, and render pictures from it."""
    from gpf.commands.demo import run_demo

    run_demo(folder)


@app.command()
def export(
    field: options.Field = None,
    ply: options.Splats = None,
    compact: options.CompactField = None,
    exposure: options.Exposure = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Write a field as 3D Gaussian splats, or in a third of its size."""
    from gpf.commands.export import export_field

    export_field(field, ply, compact, exposure, overwrite)


@app.command()
def fit(
    scene: options.Scene,
    output: options.NewField = None,
    seconds: options.FitSeconds = None,
    target_psnr: options.TargetPsnr = None,
    passes: options.Passes = None,
    frames: options.FittedFrames = None,
    views: options.Views = None,
    seed: options.Seed = 0,
    go_on: options.FinishedField = None,
    groups: options.Groups = "",
    executor: options.Executor = "local",
    cluster: options.Cluster = "",
    overwrite: options.Overwrite = False,
) -> None:
    """Fit a field to a scene.

    Stops when the first of --seconds, --target-psnr and --passes is reached. OUT.png shows the
    progress. If the fit was killed, the same command resumes it.
    """
    from gpf.commands.fit_options import FitOptions

    asked = FitOptions(
        seconds=seconds,
        target_psnr=target_psnr,
        passes=passes,
        views=views,
        seed=seed,
        groups=groups,
    )
    machines = ClusterChoice.of_options(executor, cluster)
    if frames is not None:
        from gpf.commands.fit_frames import fit_scene_frames, refuse_with_frames
        from gpf.commands.scenes import FIELDS

        refuse_with_frames({"--target-psnr": target_psnr, "--continue": go_on})
        fit_scene_frames(Path(scene), frames, output or FIELDS, asked, overwrite, machines)
        return
    if machines is not None:
        raise UserError("--executor ray", "needs --frames", "Leave it out to fit one field.")
    from gpf.commands.fit import Existing, fit_scene_file

    if go_on is not None and (output is not None or overwrite):
        other = "--output" if output is not None else "--overwrite"
        raise UserError(
            f"--continue and {other}", "are mutually exclusive", "Copy the field first."
        )
    out = go_on or output or Path("field.safetensors")
    existing: Existing = "continue" if go_on else "overwrite" if overwrite else "refuse"
    fit_scene_file(scene, out, asked, existing)


@app.command()
@with_options
def render(
    scene: options.Scene,
    field: options.FieldOfScene = None,
    view: options.ViewNames = None,
    views: options.Views = None,
    frames: options.Frames = None,
    orbit: options.Orbit = 0,
    output: options.PictureFolder = None,
    *,
    pictures: PictureOptions,
) -> None:
    """Render views of a scene from a field. Existing pictures of the same kind are kept."""
    from gpf.commands.cameras import CameraChoice
    from gpf.commands.render import render_pictures

    choice = CameraChoice(tuple(view or ()), views, frames, orbit)
    render_pictures(scene, field, choice, output, pictures)


@app.command()
def info(field: options.Field = None) -> None:
    """Show what a field is, from which scene, when it was made, how good it is, and its groups."""
    from gpf.commands.info import print_info

    print_info(field)


@app.command()
def view(
    scene: options.Scene,
    field: options.ShownField = None,
    output: options.FittedField = Path("field.safetensors"),
    views: options.JumpViews = None,
    host: options.Host = "127.0.0.1",
    port: options.Port = 0,
    opens: options.Opens = True,
    changed_scene: options.ChangedScene = False,
    groups: options.Groups = "",
) -> None:
    """Explore a scene in the browser; the picture improves as photons arrive."""
    from gpf.commands.view import ServerOptions, view_scene

    server = ServerOptions(host, port, opens)
    view_scene(scene, field, output, views, server, changed_scene, groups)


@app.command()
def mitsuba(
    scene: options.Scene,
    output: options.ImageFile = None,
    define: options.Define = None,
    sensor: options.Sensor = 0,
    spp: options.SceneSpp = 0,
    seed: options.MitsubaSeed = 0,
    overwrite: options.Overwrite = False,
) -> None:
    """Render a scene with its own integrator, which may be sppm or gpf.

    Mitsuba's own command does not find plugins that are written in Python.
    """
    from gpf.commands.mitsuba import render_scene

    render_scene(scene, output, define or [], sensor, spp, seed, overwrite)


@app.command()
def convert(
    file: options.ForeignFile,
    output: options.SceneFolder = None,
    frames: options.ConvertedFrames = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Write the scene of a .blend, .glb, .gltf, .usd, .fbx or .obj file as a Mitsuba scene.

    Blender reads the file. Other commands take such files, too, and convert them first.
    """
    from gpf.commands.convert import convert_file

    convert_file(file, output, overwrite, frames)


@app.command()
def blender_install() -> None:
    """Install Blender's Python package, which reads files of other programs (400 MB)."""
    from gpf.commands.convert import install_blender

    install_blender()


@app.command()
def blender_addon(
    output: options.AddOn = Path("photon_field.zip"), overwrite: options.Overwrite = False
) -> None:
    """Write an add-on for Blender: the render engine Photon Field."""
    from gpf.commands.addon import write_addon

    write_addon(output, overwrite)


@app.command()
def cache(clear: options.Clear = None) -> None:
    """List the converted scenes and the downloaded programs, and the room that they take."""
    from gpf.commands.cache import show_cache

    show_cache(clear)


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


def hide_types_of_flags(command: Any) -> None:
    """Show no type beside a flag in the help of a command and its own commands: a flag has no
    value."""
    for option in command.get_params(typer.Context(command)):
        if getattr(option, "is_flag", False):
            option.metavar = ""
    for inner in getattr(command, "commands", {}).values():
        hide_types_of_flags(inner)


def run_app(commands: typer.Typer, arguments: Sequence[str] | None = None) -> None:
    """Run commands; an error that the user can correct is a message and exit code 2."""
    show_log()
    command = typer.main.get_command(commands)
    hide_types_of_flags(command)
    with no_lost_interrupts():
        try:
            command(args=list(sys.argv[1:] if arguments is None else arguments))
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
