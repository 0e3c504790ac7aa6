"""Zip archives: encrypted, with sizes that are lies, odd names, links, and bombs."""

from __future__ import annotations

import io
import re
import stat
import struct
import zipfile

from hypothesis import strategies as st

from tests.fuzz import odd
from tests.fuzz.case import Case
from tests.fuzz.good import FIRST, SCENE
from tests.fuzz.scenes import IMPORTED, way_around

METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2)
NAMES = odd.TEXTS | st.sampled_from([
    *("../up.xml", "room/../../up.xml", "/root.xml", "C:\\x.xml", "C:x", "\\\\server\\x", "..\\x"),
    *("room", "room/", "room//scene.xml", "./room/./scene.xml", "room/scene.xml/inner.xml"),
    *("a" * 300, "room/" * 200 + "x", "con", "nul.xml", "x\x01y.xml", "名前.xml", "é.xml", "~/x"),
    *(".hidden.xml", "__MACOSX/scene.xml", "room/SCENE.XML", "room/scene.xml ", "room/licence"),
    *("room\\scene.xml", "room/x\ny.xml", "-rf", "room/views.yaml", "room/build.py", "a:b"),
])  # fmt: skip
ROOM = {"room/scene.xml": SCENE}
LINKS = ("/etc/passwd", "..", "scene.xml")
TYPES = (stat.S_IFCHR, stat.S_IFIFO, stat.S_IFSOCK)

# Of the records: offsets of fields and their numbers of bytes.
RECORDS = {
    b"PK\x01\x02": ((6, 2), (8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (42, 4)),
    b"PK\x03\x04": ((4, 2), (6, 2), (8, 2), (14, 4), (18, 4), (22, 4), (26, 2), (28, 2)),
    b"PK\x05\x06": ((4, 2), (8, 2), (10, 2), (12, 4), (16, 4), (20, 2)),
}


def room_with_a_way(draw: st.DrawFn) -> dict[str, str]:
    """A scene that includes a file by a way out of its folder and back in; from beside the other
    scenes, that way leads into the first of them."""
    way = way_around(draw, "first/inner", "part.xml")
    scene = SCENE.replace("</scene>", f'<include filename="{way}"/></scene>')
    part = '<scene version="3.0.0"/>'
    inner = {"nothing/": "", "part.xml": part, "scene.xml": scene}
    return {f"first/inner/{name}": text for name, text in inner.items()}


@st.composite
def odd_members(draw: st.DrawFn) -> tuple[zipfile.ZipInfo, bytes | str]:
    """A member with an odd name, of an odd kind, or of a size that is much larger than packed."""
    info = zipfile.ZipInfo(draw(NAMES))
    content: bytes | str = draw(st.sampled_from(["", SCENE, "text"]))
    way = draw(st.sampled_from(["name", "name", "link", "device", "bomb", "same", "folder"]))
    if way == "link":
        info.external_attr = (stat.S_IFLNK | 0o777) << 16
        content = draw(st.sampled_from(LINKS))
    elif way == "device":
        info.external_attr = (draw(st.sampled_from(TYPES)) | 0o666) << 16
    elif way == "bomb":
        content = bytes(10**7)
    elif way == "same":  # a folder in the place of a file, or a file in that of a folder
        info.filename = draw(st.sampled_from(["room", "room/scene.xml/x", "room/scene.xml/"]))
    elif way == "folder":
        info.filename += "/"
    return info, content


def archive_of(draw: st.DrawFn) -> bytes:
    """An archive with a scene in it, and something else."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", draw(st.sampled_from(METHODS))) as archive:
        room = ROOM if not odd.rarely(draw, 6) else room_with_a_way(draw)
        for name, text in room.items() if not odd.rarely(draw, 12) else ():
            archive.writestr(name, text)
        for info, content in draw(st.lists(odd_members(), max_size=2)):
            info.compress_type = archive.compression
            if info.filename and info.filename not in archive.namelist():
                archive.writestr(info, content)
    return buffer.getvalue()


def with_a_lie(draw: st.DrawFn, data: bytes) -> bytes:
    """Change a field of one of the archive's records: flags, method, sizes, offsets, names."""
    record = draw(st.sampled_from(list(RECORDS)))
    places = [found.start() for found in re.finditer(re.escape(record), data)]
    offset, size = draw(st.sampled_from(RECORDS[record]))
    largest = 2 ** (8 * size) - 1
    numbers = [0, 1, 8, 9, 12, 14, 93, 95, 99, 2**11, 2**15, largest - 1, largest]
    number = struct.pack("<I", draw(st.sampled_from(numbers)))[:size]
    at = offset + draw(st.sampled_from(places or [0]))
    return data[:at] + number + data[at + size :]


@st.composite
def imports(draw: st.DrawFn) -> Case:
    """`gpf scene import` of an archive."""
    data = archive_of(draw)
    for _ in range(draw(st.integers(0, 2))):
        data = with_a_lie(draw, data)
    if odd.rarely(draw, 5):
        data = odd.changed_bytes(draw, data)
    words = ("scene", "import", "room.zip", "--name", "room")
    return Case(words, IMPORTED, ("view '",), {**FIRST, "room.zip": data})
