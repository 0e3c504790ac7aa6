"""Meshes that would end the process are told with the line that names them."""

from __future__ import annotations

import struct
import zlib

import pytest

from gpf.core.errors import UserError
from gpf.scene.load import load_scene_file
from gpf.scene.meshes import check_ply, check_serialized

HEADER = """\
ply
format {form} 1.0
comment end_header is the next line but six
element vertex {vertices}
property float x
property float y
property float z
element face {faces}
{before}property list uchar int vertex_indices
{after}end_header
"""
POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]


def write(folder, corners, form="ascii", before="", after="", vertices=4, faces=1):
    head = HEADER.format(form=form, vertices=vertices, faces=faces, before=before, after=after)
    first, last = ("7 " if before else ""), (" 8" if after else "")
    if form == "ascii":
        rows = [*(f"{x} {y} {z}" for x, y, z in POINTS), f"{first}3 {corners}{last}"]
        body = "\n".join(rows).encode() + b"\n"
    else:
        sign = "<" if "little" in form else ">"
        body = b"".join(struct.pack(f"{sign}3f", *p) for p in POINTS)
        body += struct.pack(f"{sign}f", 7) * bool(before)
        body += struct.pack(f"{sign}B3i", 3, *map(int, corners.split()))
        body += struct.pack(f"{sign}f", 8) * bool(after)
    path = folder / "mesh.ply"
    path.write_bytes(head.encode() + body)
    return path


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(
    "extra", [{}, {"before": "property float q\n"}, {"after": "property float q\n"}]
)
def test_vertices_that_do_not_exist(tmp_path, form, extra):
    check_ply(write(tmp_path, "1 2 3", form, **extra), "scene.xml:4")
    for corners, wrong in (("0 1 4", 4), ("0 -1 2", -1), ("900000000 1 2", 900000000)):
        path = write(tmp_path, corners, form, **extra)
        words = (
            rf"scene\.xml:4: refers to .*mesh\.ply, which has a triangle with vertex {wrong} of 4"
        )
        with pytest.raises(UserError, match=words):
            check_ply(path, "scene.xml:4")


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("more", [{"vertices": 4 * 10**9}, {"faces": 4 * 10**9}])
def test_files_that_are_shorter_than_they_say(tmp_path, form, more):
    with pytest.raises(UserError, match="is shorter than its header says"):
        check_ply(write(tmp_path, "0 1 2", form, **more), "scene.xml:4")


@pytest.mark.parametrize(
    "data", [b"", b"ply", b"plywood\nelement face x\nend_header\n", b"\x89PNG"]
)
def test_what_is_no_mesh_is_left_to_mitsuba(tmp_path, data):
    path = tmp_path / "mesh.ply"
    path.write_bytes(data)
    check_ply(path, "scene.xml:4")


def test_scenes_are_checked_before_they_are_loaded(tmp_path):
    write(tmp_path, "0 1 900000000")
    shape = '<shape type="ply"><string name="filename" value="mesh.ply"/></shape>'
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">\n{shape}\n</scene>')
    with pytest.raises(UserError, match=r"scene\.xml:2: refers to .* vertex 900000000 of 4"):
        load_scene_file(tmp_path / "scene.xml")


def test_bytes_that_are_no_text_are_told_of(tmp_path):
    """Mitsuba's message has them, too."""
    mesh = write(tmp_path, "0 1 2")
    mesh.write_bytes(mesh.read_bytes().replace(b"list uchar int", b"list uchar \xf8t"))
    shape = '<shape type="ply"><string name="filename" value="mesh.ply"/></shape>'
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{shape}</scene>')
    with pytest.raises(UserError, match=r"scene\.xml: does not load: .*mesh\.ply.*\ufffdt"):
        load_scene_file(tmp_path / "scene.xml")


def serialized(path, meshes, version=4, flags=0x1000, faces=1):
    """Write meshes of Mitsuba's own format, each the corners of a triangle of four vertices."""
    data, places, real = b"", [], "d" if flags & 0x2000 else "f"
    values = 3 + 3 * bool(flags & 1) + 2 * bool(flags & 2) + 3 * bool(flags & 8)
    for corners in meshes:
        body = struct.pack("<I", flags) + b"mesh\0" * (version == 4)
        body += struct.pack("<QQ", len(POINTS), faces)
        body += b"".join(struct.pack(f"<3{real}", *p) for p in POINTS)
        body += struct.pack(f"<{4 * (values - 3)}{real}", *[0.5] * (4 * (values - 3)))
        body += struct.pack("<3I", *corners)
        places.append(len(data))
        data += struct.pack("<HH", 0x041C, version) + zlib.compress(body)
    data += struct.pack(f"<{len(places)}{'Q' if version == 4 else 'I'}I", *places, len(places))
    path.write_bytes(data)


SERIALIZED = """
<scene version="3.0.0">
  <shape type="serialized">
    <string name="filename" value="mesh.serialized"/><integer name="shape_index" value="1"/>
  </shape>
  <emitter type="constant"/>
</scene>
"""


@pytest.mark.parametrize("flags", [0x1000, 0x2000, 0x1001, 0x1003, 0x200B])
@pytest.mark.parametrize("version", [3, 4])
def test_meshes_of_mitsubas_own_format(tmp_path, version, flags):
    mesh = tmp_path / "mesh.serialized"
    (tmp_path / "scene.xml").write_text(SERIALIZED)
    serialized(mesh, [(0, 1, 2), (1, 3, 2)], version, flags)
    scene = load_scene_file(tmp_path / "scene.xml")
    corners = scene.shapes()[0].faces_buffer()
    assert corners.numpy().tolist() == [1, 3, 2]  # Mitsuba reads what this test has written
    serialized(mesh, [(0, 1, 2), (1, 2_000_000_000, 2)], version, flags)
    with pytest.raises(UserError, match=r"which has a triangle with vertex 2000000000 of 4\."):
        load_scene_file(tmp_path / "scene.xml")
    serialized(mesh, [(0, 1, 2)], version, flags, faces=5)
    with pytest.raises(UserError, match=r"is shorter than its header says"):
        check_serialized(mesh, "here")


def test_what_is_no_mesh_of_mitsubas_own_format_is_left_out(tmp_path):
    mesh = tmp_path / "mesh.serialized"
    serialized(mesh, [(0, 1, 2)])
    data = mesh.read_bytes()
    for damaged in (b"", data[:4], data[:3], b"\0" + data[1:], data[:4] + data[40:], data[:4] * 9):
        mesh.write_bytes(damaged)
        check_serialized(mesh, "here")


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_faces_that_are_no_triangles(tmp_path, form):
    path = write(tmp_path, "0 1 2", form)
    three, four = (
        (b"\n3 0", b"\n4 0") if form == "ascii" else (b"\x03" + bytes(4), b"\x04" + bytes(4))
    )
    path.write_bytes(path.read_bytes().replace(three, four))
    with pytest.raises(UserError, match=r"has faces that are not triangles\. Export triangles"):
        check_ply(path, "scene.xml:4")


def test_headers_as_mitsuba_reads_them(tmp_path):
    path = write(tmp_path, "1 2 9")
    good = path.read_bytes()
    for old, new in (
        (b"ply\n", b"\n ply\n"),
        (b"\nend_header\n", b"\n end_header \n"),
        (b"property list uchar int", b"property list uchar long"),
        (
            b"element face 1\n",
            b"element face 0\nproperty list uchar int vertex_indices\nelement face 1\n",
        ),
    ):
        path.write_bytes(good.replace(old, new, 1))
        with pytest.raises(UserError, match="has a triangle with vertex 9 of 4"):
            check_ply(path, "scene.xml:4")


def test_a_mesh_that_says_it_has_more_than_memory(tmp_path):
    body = struct.pack("<I", 0x1000) + b"name\0" + struct.pack("<QQ", 2**50, 1)
    path = tmp_path / "mesh.serialized"
    path.write_bytes(b"\x1c\x04\x04\x00" + zlib.compress(body) + struct.pack("<QI", 0, 1))
    with pytest.raises(UserError, match="which needs at least .* GiB of memory"):
        check_serialized(path, "scene.xml:4")


def test_a_mesh_without_triangles(tmp_path):
    """Mitsuba reads it, and each ray of a picture would end in an error of Dr.Jit. On a GPU, it
    would end the process."""
    write(tmp_path, "", faces=0).rename(tmp_path / "mesh.ply")
    (tmp_path / "mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\n")
    scene = tmp_path / "scene.xml"
    mesh = '<shape type="{kind}" id="lost"><string name="filename" value="mesh.{kind}"/></shape>'
    group = '<shape type="shapegroup" id="group">{}</shape>'
    for inside, message in (
        (mesh.format(kind="ply"), r"scene.xml:1: refers to .*mesh.ply, which has no triangles\."),
        (mesh.format(kind="obj"), r"scene.xml:1: refers to .*mesh.obj, which has no triangles\."),
        (group.format(mesh.format(kind="obj")), r"mesh.obj, which has no triangles\. Remove"),
    ):
        scene.write_text(
            '<scene version="3.0.0"><emitter type="constant"/><shape type="sphere"/>'
            f"{inside}</scene>"
        )
        with pytest.raises(UserError, match=message):
            load_scene_file(scene)
