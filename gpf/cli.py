"""The command `gpf`: the library's commands and, in a checkout of the project, the pipeline's."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from gpf.core.checkout import CHECKOUT
from gpf.core.errors import UserError, explain_file_error, is_interrupt, no_lost_interrupts
from gpf.core.progress import show_log

app = typer.Typer(
    help="Gaussian photon fields: photon mapping whose result serves every view.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


@app.command()
def demo(
    folder: Annotated[Path, typer.Argument(help="A new folder.")] = Path("gpf-demo"),
) -> None:
    """Fit a field to a pool of water in some 20 seconds, and render pictures from it."""
    from gpf.commands.demo import run_demo

    run_demo(folder)


@app.command()
def export(
    field: Annotated[str, typer.Argument(help="A field's file, or a scene that was trained.")],
    ply: Annotated[
        Path | None,
        typer.Option(metavar="OUT.ply", help="As splats, for viewers of 3D Gaussian splats."),
    ] = None,
    compact: Annotated[
        Path | None,
        typer.Option(metavar="OUT.safetensors", help="As a field, in a third of the size."),
    ] = None,
    exposure: Annotated[
        float | None,
        typer.Option(help="Of --ply; by default that of the scene's views.yaml, or the field's."),
    ] = None,
) -> None:
    """Write a field for viewers of 3D Gaussian splats, or in a third of its size."""
    from gpf.field.export import export_field

    export_field(field, ply, compact, exposure)


@app.command()
def fit(
    scene: Annotated[Path, typer.Argument(metavar="SCENE.xml", help="A Mitsuba 3 scene file.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="OUT.safetensors",
            help="The field's file. Default: field.safetensors.",
        ),
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Time for the fit.")] = None,
    target_psnr: Annotated[
        float | None,
        typer.Option(metavar="DB", help="Stop at this estimated PSNR of the images."),
    ] = None,
    passes: Annotated[
        int | None, typer.Option(help="Photon passes. Default, without other goals: 300.")
    ] = None,
    views: Annotated[
        Path | None,
        typer.Option(
            metavar="VIEWS",
            help="views.yaml or transforms.json with the cameras that the field is for; by "
            "default views.yaml beside the scene. Without it, cameras are placed in the scene.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of all random numbers.")] = 0,
    go_on: Annotated[
        Path | None,
        typer.Option(
            "--continue",
            metavar="FIELD.safetensors",
            help="Go on with a fit that ended, with more photons; the field is replaced.",
        ),
    ] = None,
    groups: Annotated[
        str,
        typer.Option(
            metavar="auto|FILE",
            help="Keep the light of emitters apart, to dim and colour it later: of each one, or of "
            "the groups in a YAML file such as `window: [sky]`.",
        ),
    ] = "",
) -> None:
    """Fit a field to a scene; it ends at the first goal. OUT.png shows how far it is.

    A fit that was killed goes on when the same command runs again.
    """
    from gpf.commands.fit import fit_scene_file

    if go_on is not None and out is not None:
        raise UserError("--continue and --out", "exclude each other", "Copy the field first.")
    out = go_on or out or Path("field.safetensors")
    fit_scene_file(scene, out, seconds, target_psnr, passes, views, seed, go_on is not None, groups)


@app.command()
def render(
    scene: Annotated[
        str, typer.Argument(metavar="SCENE.xml", help="A scene file, or a scene that was trained.")
    ],
    field: Annotated[
        Path | None,
        typer.Option(help="The field's file. Default: field.safetensors."),
    ] = None,
    view: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A camera by name; may be given several times."),
    ] = None,
    views: Annotated[
        Path | None,
        typer.Option(
            metavar="VIEWS",
            help="views.yaml or transforms.json with the cameras; by default views.yaml beside the "
            "scene or, without it, the scene's own cameras.",
        ),
    ] = None,
    frames: Annotated[
        bool, typer.Option("--frames", help="All frames of the camera path in views.yaml.")
    ] = False,
    orbit: Annotated[
        int,
        typer.Option(
            metavar="N", min=0, max=100_000, help="N cameras around what the scene's camera sees."
        ),
    ] = 0,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FOLDER", help="Default: pictures.")
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Such as 512x512; or rows alone.")
    ] = None,
    spp: Annotated[
        int | None,
        typer.Option(min=1, max=1_000_000, help="Camera samples per pixel. Default: 64."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Time for a picture, in place of --spp.")
    ] = None,
    aovs: Annotated[
        str,
        typer.Option(
            metavar="LIST",
            help="Further layers: depth, position, normal, albedo, visible_normal, irradiance, "
            "coverage, error; with commas.",
        ),
    ] = "",
    exposure: Annotated[float | None, typer.Option(help="Of the PNG files.")] = None,
    denoise: Annotated[
        bool | None,
        typer.Option(
            "--denoise/--no-denoise",
            help="With Open Image Denoise, where noise is visible. Default: if pyoidn is there.",
        ),
    ] = None,
    mp4: Annotated[bool, typer.Option("--mp4", help="A film of all pictures, too.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of all random numbers.")] = 0,
    changed_scene: Annotated[
        bool, typer.Option("--changed-scene", help="Accept the field of another scene.")
    ] = False,
    executor: Annotated[
        Literal["local", "ray"],
        typer.Option(help="`ray` spreads the pictures over the machines of a cluster."),
    ] = "local",
    cluster: Annotated[
        str,
        typer.Option(
            metavar="HOST:PORT", help="Of a Ray cluster; by default one starts on this machine."
        ),
    ] = "",
    lights: Annotated[
        str,
        typer.Option(
            metavar="LEVELS",
            help="Of a field with groups of lights: `window=0.2,lamp=1.5,#ffd0a0`.",
        ),
    ] = "",
) -> None:
    """Render views of a scene from a field; pictures that exist are kept."""
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
    render_pictures(scene, field, choice, out, options)


@app.command()
def lights(
    field: Annotated[str, typer.Argument(help="A field's file, or a scene that was trained.")],
) -> None:
    """List the groups of lights that a field keeps apart."""
    from gpf.commands.lights import list_lights

    list_lights(field)


@app.command()
def view(
    scene: Annotated[
        str, typer.Argument(metavar="SCENE.xml", help="A scene file, or a scene that was trained.")
    ],
    field: Annotated[
        Path | None,
        typer.Option(
            help="The field's file. Default: that of --out if it exists; else fit one while you "
            "look."
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", metavar="OUT.safetensors", help="Where such a field is kept."),
    ] = Path("field.safetensors"),
    views: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Cameras to jump to, and where cameras are saved. Default: views.yaml.",
        ),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address to serve on; only this machine can reach the default.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Default: any free one.")] = 0,
    opens: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page in a browser.")
    ] = True,
    changed_scene: Annotated[
        bool, typer.Option("--changed-scene", help="Accept the field of another scene.")
    ] = False,
    groups: Annotated[
        str,
        typer.Option(
            metavar="auto|FILE",
            help="For a field that is fitted: keep the light of emitters apart, as `gpf fit` does.",
        ),
    ] = "",
) -> None:
    """Fly through a scene in the browser, and watch it get better while photons come in."""
    from gpf.commands.view import ServerOptions, view_scene

    view_scene(scene, field, out, views, ServerOptions(host, port, opens), changed_scene, groups)


@app.command()
def doctor() -> None:
    """Tell what works on this machine, what is missing, and how to repair it."""
    from gpf.doctor import diagnose, print_report

    raise typer.Exit(print_report(diagnose()))


def add_benchmark_commands() -> None:
    """In a checkout of the project, add the commands of its pipeline, such as `gpf stage`."""
    if CHECKOUT is not None:
        importlib.import_module("stages.commands.benchmark").add_to(app)


add_benchmark_commands()


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
