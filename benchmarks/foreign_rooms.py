"""Published scenes, written for Mitsuba 0.x, adapted to Mitsuba 3."""

from __future__ import annotations

import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import mitsuba as mi
import typer

from gpf.core.errors import UserError

CHOI, MUELLER = "hchoi405/dppm-scenes", "Tom94/practical-path-guiding"


@dataclass(frozen=True)
class Source:
    """Where a room comes from, and what is special about it."""

    repository: str
    file: str
    what: str


ROOMS = {
    "dining-room": Source(CHOI, "scenes/dining-room/scene.xml", "sun and sky through windows"),
    "veach-lamp": Source(CHOI, "scenes/veach-lamp/scene.xml", "lamps behind shades"),
    "spaceship": Source(CHOI, "scenes/spaceship/scene.xml", "four lamps, rough glass, metal"),
    "artware": Source(CHOI, "scenes/artware/scene.xml", "glass and metal, lamps and sky"),
    "staircase": Source(CHOI, "scenes/staircase/scene.xml", "one lamp, many small shapes"),
    # These are for judging only: nothing is tuned to them.
    "kitchen": Source(MUELLER, "scenes/kitchen/kitchen.xml", "sky, steel, lacquer"),
    "classroom": Source(CHOI, "scenes/classroom/scene.xml", "sun through windows"),
    "bathroom": Source(CHOI, "scenes/bathroom/scene.xml", "one lamp, mirror, masks"),
    "bathroom2": Source(CHOI, "scenes/bathroom2/scene.xml", "bulbs in glass"),
    "living-room-2": Source(CHOI, "scenes/living-room-2/scene.xml", "four lamps"),
    "glass": Source(CHOI, "scenes/glass/scene.xml", "tumbler, ice, brushed metal"),
    "torus": Source(CHOI, "scenes/torus/scene.xml", "sun through glass"),
}

# As Mitsuba 3 reads its direction, the file's own sun is below the horizon.
SUNS = {"classroom": "0.4, 0.5, 0.6"}


def fetch(
    folder: Path,
    rooms: Annotated[
        list[str] | None, typer.Argument(metavar="[ROOM]…", help=f"Of: {', '.join(ROOMS)}.")
    ] = None,
) -> None:
    """Published scenes, adapted to Mitsuba 3.

    The repositories are cloned into FOLDER/clones, unless they are there; each room becomes a
    folder FOLDER/NAME with a scene.xml. What Mitsuba 3 lacks is replaced or left out, and the
    changes are printed. The licences of these scenes do not allow them to be part of this project.
    """
    for name in rooms or ROOMS:
        room, target = ROOMS[name], folder / name
        source = clone(room.repository, folder / "clones") / room.file
        shutil.copytree(source.parent, target, dirs_exist_ok=True)
        shutil.copyfile(source, target / "scene.xml")
        print(f"{name}: {room.what}")
        changes = Counter(mend(target / "scene.xml", SUNS.get(name)))
        for change, times in changes.items():
            print(f"    {change}" + (f" ({times} times)" if times > 1 else ""))


def clone(repository: str, folder: Path) -> Path:
    """The folder of a repository."""
    found = folder / repository.replace("/", "+")
    if not found.exists():
        address = f"https://github.com/{repository}.git"
        subprocess.run(["git", "clone", "--depth", "1", address, str(found)], check=True)
    return found


def mend(file: Path, sun: str | None) -> Iterator[str]:
    """Change a scene file until Mitsuba loads it; yields what was changed."""
    tree = ET.parse(file)
    root = tree.getroot()
    for name in root.iter("string"):
        if name.get("value") in ("phong", "as"):
            name.set("value", "beckmann")
    for texture in root.iter("texture"):
        for name in texture.findall("string"):
            if name.get("name") in ("filterType", "filter_type"):
                texture.remove(name)
    for colour in root.iter():
        value = colour.get("value", "")
        if colour.tag in ("rgb", "srgb", "spectrum") and value.startswith("#"):
            parts = (int(value[k : k + 2], 16) / 255 for k in (1, 3, 5))
            colour.tag = "rgb"
            colour.set("value", ", ".join(f"{part**2.2:.4f}" for part in parts))
        elif colour.tag == "spectrum" and ":" not in value:
            colour.tag = "rgb"
    for integrator in root.findall("integrator"):
        root.remove(integrator)
    yield from _replace(root, file.parent)
    for emitter in root.iter("emitter"):
        direction = emitter.find("vector[@name='sunDirection']")
        if sun is not None and direction is not None:
            direction.attrib = {"name": "sunDirection", "value": sun}
            yield f"sun from {sun}"
    while True:
        tree.write(file)
        try:
            mi.load_file(str(file), optimize=False)
            return
        except Exception as error:
            message = str(error)
        change = _leave_out(root, message)
        if change is None:
            raise UserError(str(file), message, "Extend benchmarks/foreign_rooms.py.")
        yield change


def _replace(root: ET.Element, folder: Path) -> Iterator[str]:
    """Replace what Mitsuba 3 lacks, and what refers to missing files."""
    for parent in list(root.iter()):
        for child in list(parent):
            kind = child.get("type")
            if child.tag == "medium" or (child.tag == "ref" and child.get("name") == "interior"):
                parent.remove(child)
                yield "a medium was left out"
            elif child.tag == "bsdf" and kind in ("ward", "phong", "roughcoating"):
                child.set("type", "roughconductor" if kind == "ward" else "roughplastic")
                yield f"{kind} becomes {child.get('type')}"
            elif child.tag in ("shape", "texture", "emitter"):
                name = child.find("string[@name='filename']")
                if name is None or (folder / name.get("value", "")).exists():
                    continue
                yield f"{name.get('value')} is missing"
                if child.tag == "shape":
                    parent.remove(child)
                    continue
                child[:] = []
                if child.tag == "texture":
                    child.set("type", "checkerboard")
                    for part in ("color0", "color1"):
                        ET.SubElement(child, "rgb", name=part, value=".5")
                else:
                    child.set("type", "constant")


def _leave_out(root: ET.Element, message: str) -> str | None:
    """Remove the properties that Mitsuba's message names from all plugins of that type."""
    plugin = re.search(r'unreferenced propert.*? in (\w+) plugin of type "(\w+)"', message)
    if plugin is None:
        return None
    names = re.findall(r'^\s*- \w+ "([\w.]+)"', message, re.MULTILINE)
    removed = 0
    for parent in root.iter(plugin[1]):
        for child in list(parent):
            own = re.sub("([A-Z])", r"_\1", child.get("name", "")).lower()  # as Mitsuba 3 spells it
            if parent.get("type") == plugin[2] and own in names:
                parent.remove(child)
                removed += 1
    return f"{plugin[2]}: {', '.join(names)} left out" if removed else None
