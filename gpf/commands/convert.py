"""`gpf convert` and `gpf blender-install`: files of other programs."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from gpf.blender.conversion import RECORD, RIGHT, Converted, convert, converted, require_file
from gpf.blender.process import install
from gpf.commands.overwriting import require_new_folder
from gpf.core.errors import UserError
from gpf.core.progress import console, say
from gpf.core.runtime import choose_variant
from gpf.scene.frames import SceneFrame


def convert_file(
    file: Path, output: Path | None, overwrite: bool, frames: str | None = None
) -> None:
    """Write a folder with the Mitsuba scene of a file.

    Parameters
    ----------
    output: by default, the file's name without its suffix.
    overwrite: whether to replace a folder that exists.
    frames: write a scene for each of these frames, as :func:`gpf.blender.conversion.convert`.

    Raises
    ------
    UserError: the folder exists and is not to be replaced, or holds something else; or as
        :func:`gpf.blender.conversion.convert`.
    """
    require_file(file)
    folder = output or file.with_suffix("")
    require_new_folder(folder, RECORD, overwrite)
    choose_variant("auto")
    with console.status(f"{file.name}: Blender") as status:
        found = convert(file, folder, lambda what: status.update(f"{file.name}: {what}"), frames)
    table = Table("material", "how")
    for name, how in sorted(found.how.items()):
        table.add_row(name, how)
    console.print(table, markup=False)
    report(found)
    say(f"{found.xml}" if frames is None else f"{folder}: {len(found.files())} frames")


def scene_of(file: Path) -> Path:
    """The scene file of a file of another program, from the cache if it has not changed.

    Raises
    ------
    UserError: nothing in it emits light; or as :func:`gpf.blender.conversion.convert`.
    """
    return _from_cache(file, None).xml


def frames_of(file: Path, wanted: str) -> list[SceneFrame]:
    """All frames of a file of another program; those that are wanted have scene files, from the
    cache if the file has not changed.

    Raises
    ------
    UserError: nothing in them emits light; or as :func:`gpf.blender.conversion.convert`.
    """
    return _from_cache(file, wanted).frames()


def _from_cache(file: Path, frames: str | None) -> Converted:
    choose_variant("auto")
    with console.status(f"{file.name}: Blender") as status:
        found = converted(file, lambda what: status.update(f"{file.name}: {what}"), frames)
    report(found)
    if not any("<emitter" in xml.read_text(encoding="utf-8") for xml in found.files()):
        what = "has no lamp, no surface that emits, and a black world: there is no light"
        raise UserError(str(file), what, "Add a lamp.")
    return found


def report(found: Converted) -> None:
    """Say what is not exact."""
    rough = {name: how for name, how in found.how.items() if how not in RIGHT}
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
