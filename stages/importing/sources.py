"""Sources of a scene: a folder, an XML file, or a zip archive with an XML file."""

from __future__ import annotations

import errno
import lzma
import shutil
import stat
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from gpf.blender.conversion import converted, is_foreign
from gpf.commands.scenes import find_scene_file
from gpf.core.errors import UserError
from gpf.core.places import make_place
from gpf.core.progress import say

MOST_FILES = 10_000
MOST_BYTES = 4 * 2**30
"""Limits on an unpacked archive: ten times the largest of the usual test scenes."""


@dataclass(frozen=True)
class Source:
    """A scene file to import.

    Attributes
    ----------
    origin: the name of the folder, file or archive that the user gave.
    xml: the scene file.
    folder: the folder that the user gave, the unpacked archive, or the folder of the XML file.
    archive: the archive that was unpacked into ``folder``, or None.
    """

    origin: str
    xml: Path
    folder: Path
    archive: Path | None = None


def open_source(path: Path, unpacked: Path) -> Source:
    """Find the scene file; unpack an archive into the new folder ``unpacked``.

    Raises
    ------
    UserError: ``path`` does not exist or is not a folder, an XML file or a zip archive; there is
        no scene file or more than one; or :func:`unpack_archive` rejects the archive.
    """
    if not path.exists():
        raise UserError(str(path), "does not exist", "Check the path.")
    origin = path.resolve().name
    if path.is_dir():
        return Source(origin, find_scene_file(path, path), path)
    if zipfile.is_zipfile(path):
        unpack_archive(path, unpacked)
        return Source(origin, find_scene_file(unpacked, path), unpacked, archive=path)
    if path.suffix.lower() == ".xml":
        return Source(origin, path, path.parent)
    if is_foreign(path):
        xml = converted(path, say).xml
        return Source(origin, xml, xml.parent)
    raise UserError(
        str(path),
        "is not a folder, an XML file, a zip archive, or a file that Blender reads",
        "Unpack other archives first.",
    )


def unpack_archive(archive: Path, target: Path) -> None:
    """Unpack a zip archive into a new folder.

    Raises
    ------
    UserError: a member has an absolute path or a path with ``..``, or is a link or another special
        file; there are more than ``MOST_FILES`` members or ``MOST_BYTES`` bytes; the archive is
        damaged or encrypted. ``target`` may then hold some of the files.
    """
    # Errors of the system for a position before the file's beginning, and for a member's name;
    # None: bz2 raises its own OSError for damaged data.
    unreadable = (errno.EINVAL, errno.ENAMETOOLONG, None)
    damages = (
        *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, ValueError, RuntimeError),
        # Two members have the same name, one as a file and one as a folder.
        *(FileExistsError, NotADirectoryError, IsADirectoryError),
    )
    try:
        with zipfile.ZipFile(archive) as opened:
            members = opened.infolist()
            _check_members(archive, members)
            for member in members:
                place = make_place(target, PurePosixPath(*_parts(member)), str(archive))
                if member.filename.endswith(("/", "\\")):
                    place.mkdir(exist_ok=True)
                    continue
                # Reads at most the size that was checked.
                with opened.open(member) as source, place.open("wb") as copy:
                    shutil.copyfileobj(source, copy)
    except (*damages, OSError) as error:
        if not isinstance(error, damages) and error.errno not in unreadable:
            raise
        raise UserError(str(archive), f"cannot be unpacked: {error}", "Pack it again.") from error


def _check_members(archive: Path, members: list[zipfile.ZipInfo]) -> None:
    size = sum(member.file_size for member in members)
    if len(members) > MOST_FILES or size > MOST_BYTES:
        raise UserError(
            str(archive),
            f"has {len(members):,} members, {size / 2**30:.1f} GiB unpacked; the limits are "
            f"{MOST_FILES:,} and {MOST_BYTES / 2**30:.0f} GiB",
            "If you trust it, unpack it yourself and import the folder.",
        )
    for member in members:
        name = member.filename
        wrong = None
        if PurePosixPath(*_parts(member, keep_root=True)).is_absolute() or ":" in name[:2]:
            wrong = "has an absolute path"
        elif ".." in _parts(member):
            wrong = "leads out of the archive"
        elif stat.S_IFMT(member.external_attr >> 16) not in (0, stat.S_IFREG, stat.S_IFDIR):
            wrong = "is a link or another special file"
        elif member.flag_bits & 1:
            wrong = "is encrypted"
        if wrong:
            raise UserError(
                str(archive), f"its member {name!r} {wrong}", "Pack it again without that member."
            )


def _parts(member: zipfile.ZipInfo, keep_root: bool = False) -> list[str]:
    """Folders and name of a member; some Windows programs separate them with backslashes."""
    parts = member.filename.replace("\\", "/").split("/")
    return ["/"] * (keep_root and parts[0] == "") + [p for p in parts if p not in ("", ".")]
