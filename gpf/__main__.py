"""`python -m gpf scene.xml`: render a Mitsuba scene; it may use the plugins `sppm` and `gpf`.

The native `mitsuba` command does not find plugins written in Python.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated

import typer

import gpf  # noqa: F401  (registers the plugins)
from gpf.core.errors import UserError
from gpf.core.runtime import choose_variant

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def render(
    scene: Annotated[Path, typer.Argument(help="Mitsuba 3 scene, XML.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Default: the scene's name with .exr.")
    ] = None,
    variant: Annotated[str, typer.Option("-m", "--mode", help="Mitsuba variant.")] = "auto",
    define: Annotated[
        list[str] | None, typer.Option("-D", "--define", help="Parameter of the scene, name=value.")
    ] = None,
    sensor: Annotated[int, typer.Option("-s", "--sensor", help="Index of the sensor.")] = 0,
    spp: Annotated[int, typer.Option(help="Samples per pixel; 0: as in the scene.")] = 0,
    seed: Annotated[int, typer.Option(help="Seed.")] = 0,
) -> None:
    """Render a scene to an image file; the suffix chooses the format."""
    import mitsuba as mi

    from gpf.scene.load import check_files, load_with_parameters

    choose_variant(variant)
    values = {}
    for item in define or []:
        name, separator, value = item.partition("=")
        if not separator:
            raise UserError(f"-D {item}", "has no =", "Write -D name=value.")
        values[name] = value
    if not scene.is_file():
        raise UserError(str(scene), "does not exist", "Check the path.")
    check_files(scene, values)
    try:
        loaded = load_with_parameters(scene, values)
    except RuntimeError as error:
        what = " ".join(str(error).split())
        raise UserError(str(scene), f"does not load: {what}", "Correct the scene.") from error
    count = len(loaded.sensors())
    if sensor not in range(count):
        raise UserError(f"-s {sensor}", f"the scene has {count} sensors", "The first has index 0.")
    start = time.perf_counter()
    target = output or scene.with_suffix(".exr")
    try:
        image = mi.render(loaded, sensor=sensor, spp=spp, seed=seed)
        mi.util.write_bitmap(str(target), image, write_async=False)
    except (RuntimeError, ValueError) as error:
        what = " ".join(str(error.__cause__ or error).split())
        raise UserError(str(scene), f"does not render: {what}", "Correct the scene.") from error
    typer.echo(f"{target}: {time.perf_counter() - start:.1f} s")


def main() -> None:
    """Run the command; a :class:`UserError` is printed as a message with exit code 2."""
    try:
        app()
    except UserError as error:
        typer.secho(f"error: {error}", fg="red", err=True)
        sys.exit(UserError.exit_code)


if __name__ == "__main__":
    main()
