"""`gpf convert` and `gpf blender-install`: files of other programs."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from gpf.blender.conversion import Converted, convert, converted
from gpf.blender.process import install
from gpf.core.progress import console, say
from gpf.core.runtime import choose_variant


def convert_file(file: Path, output: Path | None, overwrite: bool) -> None:
    """Write a folder with the Mitsuba scene of a file.

    Parameters
    ----------
    output: by default, the file's name without its suffix.
    overwrite: whether to replace a folder that exists.

    Raises
    ------
    UserError: as :func:`gpf.blender.conversion.convert`.
    """
    choose_variant("auto")
    with console.status(f"{file.name}: Blender") as status:
        found = convert(
            file,
            output or file.with_suffix(""),
            lambda what: status.update(f"{file.name}: {what}"),
            overwrite,
        )
    table = Table("material", "how")
    for name, how in sorted(found.how.items()):
        table.add_row(name, how)
    console.print(table)
    report(found)
    say(f"{found.xml}")


def scene_of(file: Path) -> Path:
    """The scene file of a file of another program, from the cache if it has not changed."""
    choose_variant("auto")
    with console.status(f"{file.name}: Blender") as status:
        found = converted(file, lambda what: status.update(f"{file.name}: {what}"))
    report(found)
    return found.xml


def report(found: Converted) -> None:
    """Say what is not exact."""
    rough = {name: how for name, how in found.how.items() if how not in ("exact", "baked")}
    for name, how in sorted(rough.items()):
        say(f"{name}: {how}")
    for note in found.notes:
        say(note)


def install_blender() -> None:
    """Install Blender's Python package in an environment of its own.

    Raises
    ------
    UserError: as :func:`gpf.blender.process.install`.
    """
    with console.status("Blender") as status:
        python = install(lambda what: status.update(what))
    say(f"{python}")
