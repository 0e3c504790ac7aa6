"""Scene files, made by a grammar of what Mitsuba reads; then parts of them are changed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

from hypothesis import strategies as st

from tests.fuzz import meshes, odd
from tests.fuzz.case import Case, Files
from tests.fuzz.good import FIRST, good_fields

IMPORTED = ("scenes/room/*",)
"""Patterns of what an import writes."""

# Symbol -> what may stand for it. `{1..0}` is a number between, `{png}` the name of a file of that
# format, and `{symbol a b}` puts a in the place of NAME and b in that of WORD.
GRAMMAR: dict[str, list[str]] = {
    "scene": [
        '<scene version="{version}">{sensor}{emitter}{lamp}{floor}<bsdf type="diffuse" id="white"/>'
        "{shapes}{strange}</scene>"
    ],
    "version": ["3.0.0"] * 40 + ["2.0", "0.6.0", "x", ""],
    "sensor": [
        '<sensor type="perspective" {id}>{fov}{eye}{film}</sensor>',
        '<sensor type="perspective" {id}>{fov}{eye}{film}</sensor>{sensor}',
        '<sensor type="thinlens" {id}>{float aperture_radius}{fov}{eye}{film}</sensor>',
        '<sensor type="orthographic" {id}>{eye}{film}</sensor>',
    ],
    "fov": ['<float name="fov" value="{60..30}"/>'],
    "eye": [
        '<transform name="to_world"><lookat origin="{0.5..-0.5}, {0.5..-0.5}, {5..3}" '
        'target="0, 0, 0" up="0, 1, 0"/></transform>'
    ],
    "film": ["{size 8 6}", "{size 1 1}{sampler}"],
    "sampler": ['<sampler type="multijitter">{integer sample_count 4}</sampler>'],
    "size": ['<film type="hdrfilm">{integer width NAME}{integer height WORD}</film>'],
    "integer": ['<integer name="NAME" value="WORD"/>'],
    "id": ["", 'id="thing_{100..0}"'],
    "floor": [
        '<shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/>'
        '<scale value="3"/></transform></shape>'
    ],
    "shapes": ["{shape}", "", "{shape}{shapes}", "{shape}{bsdf}{shapes}"],
    "shape": [
        '<shape type="{round}" {id}>{place}{float radius}{surface}</shape>',
        '<shape type="sphere"><point name="center" {xyz}/>{surface}</shape>',
        '<shape type="sphere"><point name="center" value="{three}"/>{surface}</shape>',
        '<shape type="{flat}" {id}>{place}{surface}</shape>',
        '<shape type="ply" {id}>{file ply}{place}{surface}</shape>',
        '<shape type="obj">{file obj}<boolean name="face_normals" value="true"/>{surface}</shape>',
        '<shape type="shapegroup" id="group"><shape type="cube"/></shape>'
        '<shape type="instance">{place}<ref id="group"/></shape>',
    ],
    "round": ["sphere", "cylinder"],
    "flat": ["rectangle", "cube", "disk"],
    "surface": ['<ref id="white"/>', "{bsdf}", "{bsdf}", "{bsdf}{glow}"],
    "glow": ['<emitter type="area">{rgb radiance}</emitter>'],
    "place": ["", '<transform name="to_world">{step}{steps}</transform>'],
    "steps": ["", "{step}"],
    "step": [
        "<translate {xyz}/>",
        '<rotate {xyz} angle="{90..-90}"/>',
        "<scale {xyz}/>",
        '<scale value="{2..0.5}"/>',
        '<matrix value="{2..1} {three} {1..-1} {2..1} {three} {1..-1} {2..1} {1..-1} 0 0 0 1"/>',
        '<lookat origin="{three}" target="{three}" up="0, 1, 0"/>',
    ],
    "xyz": ['x="{1..-1}" y="{1..-1}" z="{1..-1}"'],
    "three": ["{1..-1}, {1..-1}, {1..-1}"],
    "float": ['<float name="NAME" value="{0.6..0.05}"/>'],
    "rgb": ['<rgb name="NAME" value="{1..0}, {1..0}, {1..0}"/>'],
    "file": ['<string name="filename" value={NAME}/>'],
    "picture": ['<texture type="bitmap" name="NAME">{file png}</texture>'],
    "texture": ["{rgb NAME}", "{rgb NAME}", "{picture NAME}", "{checkerboard NAME}"],
    "checkerboard": [
        '<texture type="checkerboard" name="NAME"><transform name="to_uv">'
        '<scale x="{9..1}" y="3"/></transform></texture>'
    ],
    "bsdf": [
        *['<bsdf type="diffuse" {id}>{texture reflectance}</bsdf>'] * 3,
        '<bsdf type="{plain}"/>',
        '<bsdf type="{plastic}">{texture diffuse_reflectance}{ior}</bsdf>',
        '<bsdf type="principled">{texture base_color}{float roughness}</bsdf>',
        '<bsdf type="roughconductor">{float alpha}</bsdf>',
        '<bsdf type="twosided" {id}>{bsdf}</bsdf>',
        '<bsdf type="mask">{bsdf}{float opacity}</bsdf>',
        '<bsdf type="blendbsdf">{bsdf}{bsdf}{float weight}</bsdf>',
        '<bsdf type="bumpmap">{bsdf}{picture arbitrary}</bsdf>',
        '<bsdf type="normalmap">{bsdf}{picture normalmap}</bsdf>',
    ],
    "ior": ['<float name="int_ior" value="{2..1.2}"/>'],
    "plain": ["dielectric", "conductor", "thindielectric", "null"],
    "plastic": ["plastic", "roughplastic"],
    "lamp": ["", "", "{emitter}"],
    "emitter": [
        '<emitter type="constant" {id}>{rgb radiance}</emitter>',
        '<emitter type="point" {id}><point name="position" value="{1..-1}, {3..1}, 2"/>'
        "{rgb intensity}</emitter>",
        '<emitter type="spot" {id}>{place}{rgb intensity}</emitter>',
        '<emitter type="directional"><vector name="direction" {xyz}/>{rgb irradiance}</emitter>',
        '<emitter type="envmap">{file png}{float scale}</emitter>',
        '<emitter type="sunsky"><float name="turbidity" value="{9..2}"/></emitter>',
    ],
    "strange": [""] * 120 + [
        *('<include filename="scene.xml"/>', '<include filename="part.xml"/>'),
        *('<include filename="missing.xml"/>', f'<include filename="{"a" * 300}.xml"/>'),
        '<default name="x" value="$x"/><default name="y" value="$y$y$y$y"/>',
        *('<path value="nowhere"/>', f'<path value="{"a" * 300}.xml"/>', '<path value="."/>'),
        *('<alias id="floor" as="floor"/>', '<alias id="nobody" as="somebody"/>'),
        *('<ref id="nobody"/>', "<unknown/>", '<integrator type="path"/>'),
        '<medium type="homogeneous"><float name="albedo" value="0.5"/></medium>',
        '<shape type="shapegroup" id="g"><shape type="instance"><ref id="g"/></shape></shape>',
        '<bsdf type="twosided" id="s"><ref id="s"/></bsdf>',
        '<texture type="bitmap" name="data"/>',
        '<spectrum name="reflectance" value="400:0.1, 300:nan"/>',
        '<spectrum name="reflectance" filename="missing.spd"/>',
        '<transform name="to_world"><matrix value="1 2 3"/></transform>',
    ],
}  # fmt: skip
SLOT = re.compile(r"\{([^{}]+)\}")

ENTITIES = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 9}">' for k in range(1, 12))
# What no grammar makes: a text and what takes its place.
FAULTS = (
    ("<scene", "<!DOCTYPE scene><scene"),
    ("<scene", '<!DOCTYPE scene SYSTEM "scene.dtd"><scene'),
    ("<scene", f'<!DOCTYPE s [<!ENTITY e0 "ha">{ENTITIES}]><scene id="&e11;"'),
    ("<scene", '<!DOCTYPE s [<!ENTITY f SYSTEM "part.xml">]><scene'),
    *[("utf-8", coding) for coding in ("none", "utf-16", "cp1252", "punycode", "hex")],
    ('type="', 'type="type="'),
    ('type="', ""),
    ('type="', 'x="1" x="'),
    ("</scene>", "<shape>" * 20000 + "</shape>" * 20000 + "</scene>"),
    ("</scene>", '<bsdf type="twosided">' * 200 + "</bsdf>" * 200 + "</scene>"),
    ("</scene>", f"<!-- {'-' * 5000} --></scene>"),
    ("</scene>", '<shape type="sphere"/>' * 20000 + "</scene>"),
)
CODINGS = ("utf-16", "latin-1", "utf-32", "ascii", "utf-8-sig")
AWAY = ("missing.ply", "", ".", "/etc/hostname", "/dev/zero", "../x.ply", "scene.xml", "a" * 3000)
STEMS = ("名前", "é", "a b", "a&b", "a\nb", "a:b", "%s", "$x", "-rf", "\u202e", "a" * 200)
LINKS = tuple(map(Path, ("/etc/hostname", "..", "scene.xml", "missing", "/dev/zero")))


def way_around(draw: st.DrawFn, home: str, name: str) -> str:
    """A file of the folder ``home`` by a way that leads out of it, or into another folder of it,
    and back in: from another place, the same way may lead anywhere."""
    levels = draw(st.integers(0, 1 + home.count("/")))
    if levels == 0:
        return f"{draw(st.sampled_from(['.', 'nothing']))}/../{name}"
    return "/".join([*[".."] * levels, *home.split("/")[-levels:], name])


def to_tree(element: ElementTree.Element) -> list[Any]:
    """XML as nested data: tag, attributes, text, elements."""
    return [element.tag, dict(element.attrib), element.text or "", *map(to_tree, element)]


def to_xml(tree: Any) -> str:
    """Nested data as XML, also where it has changed."""
    match tree:
        case [str(tag), dict(attributes), *inner]:
            values = "".join(f" {k}={quoteattr(str(v))}" for k, v in attributes.items())
            return f"<{tag}{values}>{''.join(map(to_xml, inner))}</{tag}>"
    return escape(str(tree))


def scene_files(draw: st.DrawFn, home: str) -> Files:
    """A scene and its files, by their names in its folder."""
    files: dict[str, bytes | Path | None] = {"nothing": None}

    def fill(slot: re.Match[str]) -> str:
        symbol, name, word = [*slot[1].split(), "", ""][:3]
        if ".." in symbol:
            begin, end = map(float, symbol.split(".."))
            return f"{begin + (end - begin) * draw(st.integers(0, 100)) / 100:.4g}"
        if symbol not in GRAMMAR:
            return file(symbol)
        text = draw(st.sampled_from(GRAMMAR[symbol]))
        return SLOT.sub(fill, text.replace("NAME", name).replace("WORD", word))

    def file(form: str) -> str:
        stem = draw(st.sampled_from(STEMS)) if odd.rarely(draw, 20) else "file"
        name = f"{stem}_{len(files)}.{form}"
        files[name] = draw(meshes.files(form))
        if odd.rarely(draw, 40):
            files[name] = draw(st.sampled_from([*LINKS, Path(name)]))
        if odd.rarely(draw, 12):
            name = way_around(draw, home, name)
        if odd.rarely(draw, 12):
            name = draw(st.sampled_from(AWAY))
        return quoteattr(name)

    tree = to_tree(ElementTree.fromstring(SLOT.sub(fill, "{scene}")))
    if odd.rarely(draw, 4):
        tree[3:] = draw(st.permutations(tree[3:]))
    if not odd.rarely(draw, 4):
        tree = odd.changed_tree(draw, tree, 3)
    text = f'<?xml version="1.0" encoding="utf-8"?>\n{to_xml(tree)}\n'
    if odd.rarely(draw, 10):
        text = text.replace(*draw(st.sampled_from(FAULTS)), 1)
    data = text.encode()
    if odd.rarely(draw, 20):
        data = text.replace("floor", "é").encode(draw(st.sampled_from(CODINGS)), "ignore")
    if odd.rarely(draw, 20):
        data = odd.changed_bytes(draw, data)
    part = draw(st.sampled_from(["", '<include filename="scene.xml"/>', "{shape}", "<scene>"]))
    part = f'<scene version="3.0.0">{SLOT.sub(fill, part)}</scene>'
    return {**files, "scene.xml": data, "part.xml": part.encode()}


@st.composite
def imports(draw: st.DrawFn) -> Case:
    """`gpf scene import` of a scene in a folder."""
    inner = scene_files(draw, "case/target/theirs")
    files = {**FIRST, **{f"theirs/{name}": data for name, data in inner.items()}}
    words = ("scene", "import", "theirs", "--name", "room")
    return Case(words, IMPORTED, ("theirs/", "scenes/room", "view '", "sensor '"), files)


@st.composite
def pictures(draw: st.DrawFn) -> Case:
    """`gpf render` of a scene, with the field of another."""
    files = {**scene_files(draw, "case/target"), "field.safetensors": good_fields()["plain"]}
    words = "render scene.xml --changed-scene --size 5x4 --spp 1 --no-denoise"
    names = (".xml", "aaaa", "view '", "sensor '")
    return Case(tuple(words.split()), ("pictures/*",), names, files)
