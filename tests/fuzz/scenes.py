"""Scene files, made by a grammar that knows what Mitsuba reads and is wrong now and then."""

from __future__ import annotations

import random
import shutil
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

from tests.fuzz import meshes, odd
from tests.fuzz.case import Case

IMPORTED = ("scenes/room/*",)
"""Patterns of what an import writes."""

_TYPES = ("float", "integer", "boolean", "string", "rgb", "spectrum", "point", "vector")


class SceneGrammar:
    """Makes the text of scene files.

    Parameters
    ----------
    wild: share of the values and of the parts that are not as they should be.
    home: the folder of the scene.
    """

    def __init__(self, rng: random.Random, wild: float, home: Path) -> None:
        self.rng, self.wild, self.home = rng, wild, home
        self.ids: list[str] = []
        self.files: dict[str, bytes] = {}

    def odd(self) -> bool:
        """Whether the next thing is wrong."""
        return self.rng.random() < self.wild

    def number(self, least: float = -1, most: float = 1) -> str:
        """A number, mostly of this range."""
        if self.odd():
            few = self.rng.random() < 0.15
            return odd.text(self.rng) if few else str(odd.number(self.rng))
        return f"{self.rng.uniform(least, most):.4g}"

    def value(self, kind: str, name: str, *numbers: str) -> str:
        """A tag for a value."""
        if self.odd():
            kind = self.rng.choice(_TYPES)
        text = ", ".join(numbers)
        if kind in ("point", "vector") and len(numbers) == 3 and self.rng.random() < 0.5:
            x, y, z = map(quoteattr, numbers)
            return f'<{kind} name="{name}" x={x} y={y} z={z}/>'
        return f'<{kind} name="{name}" value={quoteattr(text)}/>'

    def triple(self, kind: str, name: str, least: float = -1, most: float = 1) -> str:
        """A tag for three numbers."""
        return self.value(kind, name, *(self.number(least, most) for _ in range(3)))

    def new_id(self) -> str:
        """An attribute with an id, perhaps one that is there already or is no name at all."""
        if self.rng.random() < 0.4:
            return ""
        name = f"thing_{len(self.ids)}"
        if self.odd():
            name = self.rng.choice([odd.text(self.rng), *self.ids, "a b", "$x"])
        self.ids.append(name)
        return f" id={quoteattr(name)}"

    def transform(self) -> str:
        """A transform of a few steps."""
        steps = []
        for _ in range(self.rng.randint(1, 2)):
            way = self.rng.choice(["translate", "rotate", "scale", "scale_all", "matrix", "lookat"])
            x, y, z = (quoteattr(self.number()) for _ in range(3))
            if way == "rotate":
                angle = quoteattr(self.number(-90, 90))
                steps.append(f"<rotate x={x} y={y} z={z} angle={angle}/>")
            elif way == "scale_all":
                steps.append(f"<scale value={quoteattr(self.number(0.5, 2))}/>")
            elif way == "matrix":
                numbers = [self.number() if k % 5 else self.number(1, 2) for k in range(12)]
                numbers += ["0", "0", "0", "1"]
                numbers = numbers[: 15 if self.odd() else 16]
                steps.append(f"<matrix value={quoteattr(' '.join(numbers))}/>")
            elif way == "lookat" and self.rng.random() < 0.3:
                three = [", ".join(self.number() for _ in range(3)) for _ in range(2)]
                o, t = map(quoteattr, three)
                steps.append(f'<lookat origin={o} target={t} up="0, 1, 0"/>')
            else:
                name = "translate" if way == "translate" else "scale"
                steps.append(f"<{name} x={x} y={y} z={z}/>")
        return f'<transform name="to_world">{"".join(steps)}</transform>'

    def texture(self, name: str) -> str:
        """A texture or a plain colour."""
        way = self.rng.random()
        if way < 0.5:
            return self.triple("rgb", name, 0, 1)
        if way < 0.65:
            return f'<texture type="checkerboard" name="{name}">{self.transform_uv()}</texture>'
        return self.picture(name)

    def picture(self, name: str) -> str:
        """A texture from a file."""
        file = f"picture_{len(self.files)}.png"
        self.files[file] = meshes.png(self.rng, self.wild)
        kind = "bitmap" if not self.odd() else odd.text(self.rng)
        text = f'<string name="filename" value={quoteattr(self.file(file))}/>'
        return f'<texture type={quoteattr(kind)} name="{name}">{text}</texture>'

    def transform_uv(self) -> str:
        """The transform of a texture."""
        scale = quoteattr(self.number(1, 9))
        return f'<transform name="to_uv"><scale x={scale} y="3"/></transform>'

    def file(self, name: str) -> str:
        """The name of a file, perhaps of one that is not there, or by a way around."""
        if self.rng.random() < 0.1:
            return way_around(self.rng, self.home, name)
        away = ["missing.ply", ".", "/etc/hostname", "../x.ply", "scene.xml", odd.text(self.rng)]
        return self.rng.choice(away) if self.odd() else name

    def bsdf(self, depth: int = 0) -> str:
        """A material."""
        kinds = [
            "diffuse",
            "diffuse",
            "diffuse",
            "dielectric",
            "conductor",
            "plastic",
            "principled",
        ]
        kinds += ["roughplastic", "roughconductor", "twosided", "mask", "blendbsdf", "bumpmap"]
        kinds += ["normalmap", "thindielectric", "null"]
        kind = self.rng.choice(kinds)
        inner = ""
        if kind in ("twosided", "mask", "blendbsdf", "bumpmap", "normalmap") and depth < 3:
            count = 2 if kind == "blendbsdf" else 1
            inner = "".join(self.bsdf(depth + 1) for _ in range(count if not self.odd() else 3))
            if kind == "mask":
                inner += self.value("float", "opacity", self.number(0, 1))
            elif kind == "blendbsdf":
                inner += self.value("float", "weight", self.number(0, 1))
            elif kind in ("bumpmap", "normalmap"):
                inner += self.picture("normalmap" if kind == "normalmap" else "arbitrary")
        elif kind == "diffuse":
            inner = self.texture("reflectance")
        elif kind in ("plastic", "roughplastic"):
            inner = self.texture("diffuse_reflectance") + self.value(
                "float", "int_ior", self.number(1.2, 2)
            )
        elif kind == "dielectric":
            inner = self.value("float", "int_ior", self.number(1.2, 2))
        elif kind == "principled":
            inner = self.texture("base_color") + self.value("float", "roughness", self.number(0, 1))
        elif kind == "roughconductor":
            inner = self.value("float", "alpha", self.number(0.01, 0.5))
        if self.odd():
            kind = odd.text(self.rng)
        return f"<bsdf type={quoteattr(kind)}{self.new_id()}>{inner}</bsdf>"

    def shape(self) -> str:
        """A shape with its material."""
        kind = self.rng.choice(
            ["rectangle", "sphere", "cube", "disk", "cylinder", "ply", "obj", "instance", "sphere"]
        )
        inner = self.transform() if self.rng.random() < 0.7 else ""
        if kind == "sphere":
            inner += self.triple("point", "center")
            inner += self.value("float", "radius", self.number(0.05, 0.6))
        elif kind == "cylinder":
            inner += self.value("float", "radius", self.number(0.05, 0.6))
        elif kind in ("ply", "obj"):
            name = f"mesh_{len(self.files)}.{kind}"
            self.files[name] = getattr(meshes, kind)(self.rng, self.wild)
            inner += f'<string name="filename" value={quoteattr(self.file(name))}/>'
            if self.rng.random() < 0.2:
                inner += '<boolean name="face_normals" value="true"/>'
        elif kind == "instance":
            group = f"group_{self.rng.randrange(10**6)}"
            part = f'<shape type="shapegroup" id="{group}"><shape type="cube"/></shape>'
            return f'{part}<shape type="instance">{inner}<ref id="{group}"/></shape>'
        if self.ids and self.rng.random() < 0.3:
            name = odd.text(self.rng) if self.odd() else self.rng.choice(self.ids)
            inner += f"<ref id={quoteattr(name)}/>"
        else:
            inner += self.bsdf()
        if self.rng.random() < 0.15:
            radiance = self.triple("rgb", "radiance", 0, 5)
            inner += f'<emitter type="area">{radiance}</emitter>'
        if self.odd():
            inner += self.rng.choice([self.shape, self.bsdf, self.emitter, self.transform])()
        if self.odd():
            kind = odd.text(self.rng)
        return f"<shape type={quoteattr(kind)}{self.new_id()}>{inner}</shape>"

    def emitter(self) -> str:
        """A lamp."""
        kind = self.rng.choice(["point", "constant", "spot", "directional", "envmap", "sunsky"])
        inner = ""
        if kind in ("point", "spot"):
            where = self.triple("point", "position", 1, 3) if kind == "point" else self.transform()
            inner = where + self.triple("rgb", "intensity", 1, 9)
        elif kind == "constant":
            inner = self.triple("rgb", "radiance", 0, 2)
        elif kind == "directional":
            inner = self.triple("vector", "direction") + self.triple("rgb", "irradiance", 0, 2)
        elif kind == "envmap":
            name = f"sky_{len(self.files)}.png"
            self.files[name] = meshes.png(self.rng, self.wild)
            inner = f'<string name="filename" value={quoteattr(self.file(name))}/>'
            inner += self.value("float", "scale", self.number(0.1, 2))
        elif kind == "sunsky":
            inner = self.value("float", "turbidity", self.number(2, 9))
        return f'<emitter type="{kind}"{self.new_id()}>{inner}</emitter>'

    def sensor(self) -> str:
        """A camera."""
        eye = ", ".join(self.number(-0.5, 0.5) if k < 2 else self.number(3, 5) for k in range(3))
        film = self.value("integer", "width", str(self.rng.choice([1, 8, 9]))) + self.value(
            "integer", "height", str(self.rng.choice([1, 6, 8]))
        )
        if self.odd():
            size = self.rng.choice(["0", "-1", "2147483647", "100000", "x", "1e9"])
            film += f'<integer name="{self.rng.choice(["width", "height"])}" value="{size}"/>'
            film = film.partition("/>")[2]
        kind = self.rng.choice(["perspective"] * 12 + ["thinlens", "orthographic"])
        lens = '<float name="aperture_radius" value="0.1"/>' if kind == "thinlens" else ""
        look = f'<lookat origin={quoteattr(eye)} target="0, 0, 0" up="0, 1, 0"/>'
        place = self.transform() if self.odd() else f'<transform name="to_world">{look}</transform>'
        fov = "" if kind == "orthographic" else self.value("float", "fov", self.number(30, 60))
        inner = f'{fov}{lens}{place}<film type="hdrfilm">{film}</film>'
        return f'<sensor type="{kind}"{self.new_id()}>{inner}</sensor>'

    def scene(self) -> str:
        """A whole scene."""
        floor = '<shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" '
        floor += 'angle="-90"/><scale value="3"/></transform></shape>'
        parts = [self.sensor(), *(self.emitter() for _ in range(self.rng.choice([1, 1, 2])))]
        parts += [] if self.odd() else [floor]
        parts += [self.bsdf() for _ in range(self.rng.randint(0, 2))]
        parts += [self.shape() for _ in range(self.rng.randint(0, 4))]
        parts += [self.strange()] if self.odd() else []
        if self.rng.random() < 0.3:
            self.rng.shuffle(parts)
        head = '<?xml version="1.0" encoding="utf-8"?>\n'
        version = self.rng.choice(["2.0", "x", "0.6.0", ""]) if self.odd() else "3.0.0"
        return f'{head}<scene version="{version}">\n' + "\n".join(parts) + "\n</scene>\n"

    def strange(self) -> str:
        """A part that belongs into hardly any scene."""
        deep = self.rng.choice([5, 200, 20000])
        parts = (
            '<include filename="scene.xml"/>',
            '<include filename="part.xml"/>',
            '<include filename="missing.xml"/>',
            f'<include filename="{"a" * 300}.xml"/>',
            '<default name="x" value="$x"/><default name="y" value="$y$y$y$y"/>',
            '<path value="nowhere"/>',
            f'<path value="{"a" * 300}"/>',
            '<path value="."/>',
            '<alias id="floor" as="floor"/>',
            '<alias id="nobody" as="somebody"/>',
            "<ref id='nobody'/>",
            "<unknown/>",
            '<medium type="homogeneous"><float name="albedo" value="0.5"/></medium>',
            '<integrator type="path"/>',
            '<shape type="shapegroup" id="g"><shape type="instance"><ref id="g"/></shape></shape>',
            '<bsdf type="twosided" id="s"><ref id="s"/></bsdf>',
            "<shape>" * deep + "</shape>" * deep,
            '<bsdf type="twosided">' * deep + "</bsdf>" * deep,
            '<texture type="bitmap" name="data"/>',
            '<spectrum name="reflectance" value="400:0.1, 300:nan"/>',
            '<spectrum name="reflectance" filename="missing.spd"/>',
            "text between tags",
            "<!-- " + "-" * 5000 + " -->",
        )
        return self.rng.choice(parts)


def way_around(rng: random.Random, home: Path, name: str) -> str:
    """A file of the folder ``home`` by a way that leads out of it, or into another folder of it,
    and back in: from another place, the same way may lead anywhere."""
    levels = rng.randint(0, 4)
    if levels == 0:
        return f"{rng.choice(['.', 'nothing'])}/../{name}"
    return "/".join([*[".."] * levels, *home.parts[-levels:], name])


def change_text(rng: random.Random, text: str) -> bytes:
    """The bytes of a scene file with a fault that no grammar makes."""
    way = rng.choice(["doctype", "entities", "bytes", "coding", "name", "attribute", "cut", "file"])
    root = "<scene"
    if way == "doctype":
        kind = rng.choice(["<!DOCTYPE scene>", '<!DOCTYPE scene SYSTEM "scene.dtd">'])
        return text.replace(root, f"{kind}{root}", 1).encode()
    if way == "entities":
        rows = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 9}">' for k in range(1, 12))
        text = text.replace(root, f'<!DOCTYPE s [<!ENTITY e0 "ha">{rows}]>{root}', 1)
        return text.replace('id="floor"', 'id="&e11;"', 1).encode()
    if way == "file":
        text = text.replace(root, f'<!DOCTYPE s [<!ENTITY f SYSTEM "scene.xml">]>{root}', 1)
        return text.replace("</scene>", "&f;</scene>").encode()
    if way == "coding":
        code = rng.choice(["utf-16", "latin-1", "utf-32", "ascii", "utf-8-sig"])
        told = rng.choice(["utf-8", "utf-16", "latin-1", "none", "cp1252", "hex", "punycode"])
        return text.replace("utf-8", told, 1).replace("floor", "é").encode(code, "ignore")
    if way == "name":
        return text.encode().replace(b'"floor"', b'"fl\xff\xfe\x00oor"', 1)
    if way == "attribute":
        return text.replace(
            'type="', rng.choice(['type="type="', "", "type=", 'x="1" x="']), 1
        ).encode()
    if way == "cut":
        return text[: rng.randrange(len(text))].encode()
    return odd.change_bytes(rng, text.encode(), rng.randint(1, 6))


def write_scene(rng: random.Random, folder: Path) -> None:
    """A scene and its files."""
    folder.mkdir(exist_ok=True)
    (folder / "nothing").mkdir()
    grammar = SceneGrammar(rng, rng.choice([0.003, 0.01, 0.03, 0.1]), folder)
    text = grammar.scene()
    data = text.encode()
    if rng.random() < 0.15:
        data = change_text(rng, text)
    (folder / "scene.xml").write_bytes(data)
    part = rng.choice(['<include filename="scene.xml"/>', grammar.shape(), "", "<scene>"])
    (folder / "part.xml").write_text(f'<scene version="3.0.0">{part}</scene>')
    for name, content in grammar.files.items():
        (folder / name).write_bytes(content)


def make_first_scene(folder: Path, good: Path) -> None:
    """A folder of scenes with one scene in it."""
    first = folder / "scenes" / "first"
    first.mkdir(parents=True)
    for name in ("scene.xml", "views.yaml"):
        shutil.copyfile(good / name, first / name)


def make_import(rng: random.Random, folder: Path, good: Path) -> Case:
    """`gpf scene import` of a scene in a folder."""
    write_scene(rng, folder / "theirs")
    make_first_scene(folder, good)
    words: Sequence[str] = ("scene", "import", "theirs", "--name", "room")
    return Case(tuple(words), IMPORTED, ("theirs/", "scenes/room", "view '", "sensor '"))


def make_picture(rng: random.Random, folder: Path, good: Path) -> Case:
    """`gpf render` of a scene, with the field of another."""
    write_scene(rng, folder)
    (folder / "field.safetensors").symlink_to(good / "field.safetensors")
    words = ("render", "scene.xml", "--changed-scene", "--size", "5x4", "--spp", "1")
    return Case(
        (*words, "--no-denoise"), ("pictures/*",), ("scene.xml", "part.xml", "view '", "sensor '")
    )
