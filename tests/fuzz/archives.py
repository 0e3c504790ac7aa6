"""Zip archives: encrypted, with sizes that are lies, odd names, links, and bombs."""

from __future__ import annotations

import io
import random
import stat
import struct
import zipfile
from pathlib import Path

from tests.fuzz import odd
from tests.fuzz.case import Case
from tests.fuzz.scenes import IMPORTED, make_first_scene, way_around

NAMES = (
    *("../up.xml", "room/../../up.xml", "/root.xml", "C:\\x.xml", "C:x", "\\\\server\\x", "..\\x"),
    *(
        "room/scene.xml/inner.xml",
        "room",
        "room/",
        "room//scene.xml",
        "./room/./scene.xml",
        "a" * 300,
    ),
    *(
        "room/" * 200 + "x",
        "con",
        "nul.xml",
        "x\x01y.xml",
        "名前.xml",
        "é.xml",
        " ",
        ".",
        "..",
        "~/x",
    ),
    *(".hidden.xml", "__MACOSX/scene.xml", "room/SCENE.XML", "room/scene.xml ", "room/licence"),
    *("room\\scene.xml", "room/x\ny.xml", "-rf", "room/views.yaml", "room/build.py", "a:b"),
)


def make_archive(rng: random.Random, good: Path) -> bytes:
    """An archive with a good scene in it, and something else."""
    buffer = io.BytesIO()
    way = rng.choice(
        [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2]
    )
    with zipfile.ZipFile(buffer, "w", way) as archive:
        scene = (good / "scene.xml").read_bytes()
        if rng.random() < 0.8:
            archive.writestr("room/scene.xml", scene)
        elif rng.random() < 0.7:
            add_way_around(rng, archive, scene)
        for _ in range(rng.choice([0, 0, 1, 2])):
            add_odd_member(rng, archive, scene)
    return buffer.getvalue()


def add_way_around(rng: random.Random, archive: zipfile.ZipFile, scene: bytes) -> None:
    """A scene that includes a file by a way out of its folder and back in; from beside the other
    scenes, that way leads into the first of them."""
    way = way_around(rng, Path("first/inner"), "part.xml")
    archive.writestr("first/inner/nothing/", b"")
    archive.writestr("first/inner/part.xml", b'<scene version="3.0.0"/>')
    include = f'<include filename="{way}"/></scene>'.encode()
    archive.writestr("first/inner/scene.xml", scene.replace(b"</scene>", include))


def add_odd_member(rng: random.Random, archive: zipfile.ZipFile, scene: bytes) -> None:
    """A member with an odd name, of an odd kind, or of a size that is much larger than packed."""
    info = zipfile.ZipInfo(rng.choice(NAMES))
    info.compress_type = archive.compression
    content = rng.choice([b"", scene, b"text"])
    way = rng.choice(["name", "name", "link", "device", "bomb", "same", "folder"])
    if way == "link":
        info.external_attr = (stat.S_IFLNK | 0o777) << 16
        content = rng.choice([b"/etc/passwd", b"..", b"scene.xml"])
    elif way == "device":
        info.external_attr = (rng.choice([stat.S_IFCHR, stat.S_IFIFO, stat.S_IFSOCK]) | 0o666) << 16
    elif way == "bomb":
        content = bytes(10**7)
    elif way == "same":  # a folder in the place of a file, or a file in that of a folder
        info.filename = rng.choice(["room", "room/scene.xml/x", "room/scene.xml/"])
    elif way == "folder":
        info.filename += "/"
    if info.filename not in archive.namelist():
        archive.writestr(info, content)


def lie(rng: random.Random, data: bytes) -> bytes:
    """Change a field of one of the archive's records: flags, method, sizes, offsets, names."""
    changed = bytearray(data)
    record = rng.choice([b"PK\x01\x02", b"PK\x03\x04", b"PK\x05\x06"])
    places = [k for k in range(len(data)) if data.startswith(record, k)]
    if not places:
        return data
    # Of the records: offsets of fields and their numbers of bytes.
    fields = {
        b"PK\x01\x02": [(6, 2), (8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (42, 4)],
        b"PK\x03\x04": [(4, 2), (6, 2), (8, 2), (14, 4), (18, 4), (22, 4), (26, 2), (28, 2)],
        b"PK\x05\x06": [(4, 2), (8, 2), (10, 2), (12, 4), (16, 4), (20, 2)],
    }
    at, size = rng.choice(fields[record])
    at += rng.choice(places)
    largest = 2 ** (8 * size) - 1
    number = rng.choice([0, 1, 8, 9, 12, 14, 93, 95, 99, 2**15, largest, largest - 1, 2**11])
    changed[at : at + size] = struct.pack("<I", min(number, largest))[:size]
    return bytes(changed)


def make_import(rng: random.Random, folder: Path, good: Path) -> Case:
    """`gpf scene import` of an archive."""
    make_first_scene(folder, good)
    data = make_archive(rng, good)
    for _ in range(rng.choice([0, 0, 1, 1, 2])):
        data = lie(rng, data)
    if rng.random() < 0.2:
        data = odd.change_bytes(rng, data)
    (folder / "room.zip").write_bytes(data)
    return Case(("scene", "import", "room.zip", "--name", "room"), IMPORTED, ("view '",))
