"""Scene files read without Mitsuba: lines, parameters, and the files that Mitsuba would read."""

from pathlib import Path

import mitsuba as mi
import pytest

from gpf.cli import main
from gpf.core.errors import UserError
from gpf.scene.xml import DEEPEST_INCLUDE, read_scene_xml
from stages.importing.sources import open_source

PLY = """\
ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
{x} 0 0
1 1 0
0 1 1
3 0 1 2
"""


def write(folder: Path, **files: str) -> Path:
    """Files by name, ``__`` for a slash and ``_`` for a dot; scene.xml is returned."""
    for name, text in files.items():
        path = folder / name.replace("__", "/").replace("_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder / "scene.xml"


def scene(body: str) -> str:
    return f'<scene version="3.0.0">{body}</scene>'


def ply(name: str) -> str:
    return f'<shape type="ply"><string name="filename" value="{name}"/></shape>'


def names(file: Path) -> list[str]:
    return [path.relative_to(file.parent).as_posix() for path in read_scene_xml(file).files()]


def least_x(file: Path) -> list[float]:
    """Which mesh files Mitsuba reads: every one has another first coordinate."""
    return [float(s.bbox().min.x) for s in mi.load_file(str(file), optimize=False).shapes()]


def test_tags_know_their_file_and_line(tmp_path):
    file = write(
        tmp_path,
        scene_xml='<!-- a\nb -->\n<scene version="3.0.0">\n\n  <include filename="part.xml"/>\n'
        '  <shape\n    type="sphere"/>\n</scene>',
        part_xml='<scene version="2.1.0">\n<emitter type="point"/></scene>',
    )
    tags = read_scene_xml(file).tags
    assert [(tag.name, tag.place.file.name, tag.place.line) for tag in tags] == [
        ("scene", "scene.xml", 3),
        ("include", "scene.xml", 5),
        ("scene", "part.xml", 1),
        ("emitter", "part.xml", 2),
        ("shape", "scene.xml", 6),
    ]
    assert [tag.is_root for tag in tags] == [True, False, True, False, False]
    assert str(tags[4].place) == f"{file}:6"


def test_parameters_are_filled_in_as_mitsuba_does(tmp_path):
    file = write(
        tmp_path,
        scene_xml=scene(
            '<default name="a" value="m"/><default name="ab" value="x/n"/>'
            '<default name="a" value="other"/>'
            + ply("$a.ply") + ply("$ab.ply") + ply("$ac.ply") + ply("\\$a.ply")
        ),
        m_ply=PLY.format(x=-2), x__n_ply=PLY.format(x=-3), mc_ply=PLY.format(x=-4),
        **{"$a_ply": PLY.format(x=-5)},
    )  # fmt: skip
    assert names(file) == ["m.ply", "x/n.ply", "mc.ply", "$a.ply"]
    assert least_x(file) == [-2, -3, -4, -5]
    document = read_scene_xml(file)
    assert document.defaults == {"a": "m", "ab": "x/n"}
    assert document.parameters == {"a", "ab", "ac"}


def test_a_parameter_without_a_value_is_left_to_mitsuba(tmp_path):
    file = write(tmp_path, scene_xml=scene(ply("$late.ply") + '<default name="late" value="x"/>'))
    document = read_scene_xml(file)
    assert document.references == []
    assert document.parameters == {"late"}
    with pytest.raises(RuntimeError, match="undefined parameter"):
        mi.load_file(str(file))


def test_plugins_look_beside_the_scene_file_and_includes_beside_their_own(tmp_path):
    file = write(
        tmp_path,
        scene_xml=scene('<include filename="sub/a.xml"/>'),
        sub__a_xml=scene('<include filename="b.xml"/>' + ply("m.ply")),
        sub__b_xml=scene(ply("sub/m.ply")),
        b_xml=scene(""),
        m_ply=PLY.format(x=-2),
        sub__m_ply=PLY.format(x=-3),
    )
    assert names(file) == ["sub/a.xml", "sub/b.xml", "sub/m.ply", "m.ply"]
    assert least_x(file) == [-3, -2]
    (tmp_path / "sub/b.xml").unlink()  # then the one where the inclusion began
    assert names(file) == ["sub/a.xml", "b.xml", "m.ply"]
    assert least_x(file) == [-2]


def test_spectra_look_where_their_file_was_included_from(tmp_path):
    spectrum = '<spectrum name="reflectance" filename="s.spd"/>'
    shape = f'<shape type="sphere"><bsdf type="diffuse">{spectrum}</bsdf></shape>'
    file = write(
        tmp_path,
        scene_xml=scene('<include filename="sub/a.xml"/>'),
        sub__a_xml=scene(shape),
        s_spd="400 .1\n700 .1\n",
        sub__s_spd="400 .9\n700 .9\n",
    )
    assert names(file) == ["sub/a.xml", "s.spd"]
    material = mi.load_file(str(file)).shapes()[0].bsdf()
    value = float(mi.traverse(material)["reflectance.value"].x[0])
    assert value == pytest.approx(0.1, abs=0.01)
    (tmp_path / "s.spd").unlink()
    assert [m.path for m in read_scene_xml(file).missing()] == [tmp_path / "s.spd"]
    with pytest.raises(RuntimeError, match="does not exist"):
        mi.load_file(str(file))


def test_paths_of_the_scene_file_come_first_wherever_they_stand(tmp_path):
    file = write(
        tmp_path,
        scene_xml=scene(ply("m.ply") + '<path value="lib"/>' + ply("n.ply")),
        m_ply=PLY.format(x=-2),
        lib__m_ply=PLY.format(x=-3),
        n_ply=PLY.format(x=-4),
    )
    assert names(file) == ["lib/m.ply", "n.ply"]
    assert least_x(file) == [-3, -4]
    (folder,) = [r for r in read_scene_xml(file).references if r.is_folder]
    assert folder.path == tmp_path / "lib"


def test_a_file_of_the_current_folder_is_missing(tmp_path, monkeypatch):
    file = write(tmp_path / "here", scene_xml=scene("\n" + ply("m.ply") + "\n" + ply("m.ply")))
    write(tmp_path, m_ply=PLY.format(x=-2))
    monkeypatch.chdir(tmp_path)
    (missing,) = read_scene_xml(file).missing()
    assert (missing.path, missing.place.line) == (tmp_path / "here/m.ply", 2)


def test_a_circle_of_includes_is_told_with_its_line(tmp_path):
    file = write(
        tmp_path,
        scene_xml=scene('<include filename="a.xml"/>'),
        a_xml=scene('\n<include filename="sub/../scene.xml"/>'),
        sub__b_xml=scene(""),
    )
    with pytest.raises(UserError, match=r"a\.xml:2: includes .*scene\.xml, which includes it"):
        read_scene_xml(file)


@pytest.mark.parametrize("below", [DEEPEST_INCLUDE, DEEPEST_INCLUDE + 1])
def test_includes_may_be_nested_as_deep_as_in_mitsuba(tmp_path, below):
    inner = [f'<include filename="{k + 1}.xml"/>' for k in range(below)]
    files = {f"{k}_xml": scene(text) for k, text in enumerate([*inner, ""])}
    file = write(tmp_path, scene_xml=scene('<include filename="1.xml"/>'), **files)
    if below > DEEPEST_INCLUDE:
        words = rf"{DEEPEST_INCLUDE}\.xml:1: is nested in more than {DEEPEST_INCLUDE} includes"
        with pytest.raises(UserError, match=words):
            read_scene_xml(file)
        with pytest.raises(RuntimeError, match="maximum include recursion"):
            mi.load_file(str(file))
    else:
        read_scene_xml(file)
        mi.load_file(str(file))


def test_a_link_to_itself_is_missing(tmp_path):
    file = write(tmp_path, scene_xml=scene('<include filename="a.xml"/>'))
    (tmp_path / "a.xml").symlink_to("a.xml")
    assert [r.path.name for r in read_scene_xml(file).missing()] == ["a.xml"]
    with pytest.raises(UserError, match="does not exist"):
        open_source(tmp_path / "a.xml", tmp_path / "unpacked")


@pytest.mark.parametrize("name", ["a" * 300 + ".xml", "a/" * 5000 + "b.xml"])
def test_a_name_that_no_file_can_have(tmp_path, capsys, name):
    file = write(tmp_path, scene_xml=scene(f'<include filename="{name}"/>'))
    with pytest.raises(SystemExit) as ending:
        main(["fit", str(file)])
    assert ending.value.code == 2
    assert "File name too long" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b'<scene version="3.0.0">\n<shape></scene>', r"does not parse: mismatched tag: line 2"),
        (b"", r"does not parse: no element found"),
        (b"solid cube", r"does not parse: syntax error: line 1"),
        (b'<?xml version="1.0" encoding="klingon"?><scene/>', r"does not parse: unknown encoding"),
        (b'<?xml version="1.0" encoding="utf-7"?><scene/>', r"does not parse: .*encoding"),
        (b'<scene a="\xff"/>', r"does not parse: not well-formed"),
    ],
)
def test_what_is_no_xml_is_told_in_words(tmp_path, data, words):
    file = tmp_path / "scene.xml"
    file.write_bytes(data)
    with pytest.raises(UserError, match=words):
        read_scene_xml(file)


def test_other_encodings_are_read(tmp_path):
    file = tmp_path / "scene.xml"
    text = '<?xml version="1.0" encoding="iso-8859-1"?>' + scene(ply("Würfel.ply"))
    file.write_bytes(text.encode("latin-1"))
    assert names(file) == ["Würfel.ply"]


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(UserError, match=r"lost\.xml: cannot be read\. Check the path"):
        read_scene_xml(tmp_path / "lost.xml")


@pytest.mark.parametrize(
    "kind", ["<!DOCTYPE scene>", '<!DOCTYPE s SYSTEM "s.dtd">', '<!DOCTYPE s [<!ENTITY a "b">]>']
)
def test_document_types_are_refused(tmp_path, kind):
    file = tmp_path / "scene.xml"
    file.write_text(f'<?xml version="1.0"?>\n{kind}<scene version="3.0.0"/>')
    with pytest.raises(UserError, match=r"scene\.xml:2: has a document type \(DOCTYPE\)\. Remove"):
        read_scene_xml(file)


@pytest.mark.parametrize(("coding", "id"), [("utf8", "é"), ("latin1", "é"), ("cp1252", "e")])
def test_encodings_that_mitsuba_reads(tmp_path, coding, id):
    file = tmp_path / "scene.xml"
    text = (
        f'<?xml version="1.0" encoding="{coding}"?><scene version="3.0.0"><bsdf id="{id}"/></scene>'
    )
    file.write_bytes(text.encode(coding))
    assert read_scene_xml(file).tags[1].attributes["id"] == id


def test_encodings_that_mitsuba_does_not_know_are_refused(tmp_path):
    file = tmp_path / "scene.xml"
    text = '<?xml version="1.0" encoding="latin-1"?><scene version="3.0.0"><bsdf id="é"/></scene>'
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(
        UserError, match=r"scene\.xml: does not parse: unknown encoding latin-1\. Save it as UTF"
    ):
        read_scene_xml(file)


def test_parameters_within_parameters_do_not_fill_the_memory(tmp_path):
    """Twenty lines that double the length of a text, each."""
    lines = ['<default name="a0" value="0123456789"/>']
    lines += [f'<default name="a{k}" value="{"$a" + str(k - 1)}$a{k - 1}"/>' for k in range(1, 30)]
    file = write(tmp_path, scene_xml=scene("\n".join(lines)))
    with pytest.raises(UserError, match=r"scene\.xml:15: has more than 100,000 characters"):
        read_scene_xml(file)
