"""`python -m benchmarks.foreign_rooms FOLDER [ROOM …]`: published scenes, adapted to Mitsuba 3.

The repositories are cloned into `FOLDER/clones`, unless they are there; each room becomes a folder
`FOLDER/NAME` with a `scene.xml`. The files were written for Mitsuba 0.x: what Mitsuba 3 lacks is
replaced or left out (:func:`mend`), and the changes are printed. Their licences do not allow them
to be part of this project.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi

CHOI, MUELLER = "hchoi405/dppm-scenes", "Tom94/practical-path-guiding"


@dataclass(frozen=True)
class Source:
    """Where a room comes from, what is special about it, and whether it is for judging only."""

    repository: str
    file: str
    what: str
    judges: bool = False


ROOMS = {
    "dining-room": Source(CHOI, "scenes/dining-room/scene.xml", "sun and sky through windows"),
    "veach-lamp": Source(CHOI, "scenes/veach-lamp/scene.xml", "lamps behind shades"),
    "spaceship": Source(CHOI, "scenes/spaceship/scene.xml", "four lamps, rough glass, metal"),
    "artware": Source(CHOI, "scenes/artware/scene.xml", "glass and metal, lamps and sky"),
    "staircase": Source(CHOI, "scenes/staircase/scene.xml", "one lamp, many small shapes"),
    "kitchen": Source(MUELLER, "scenes/kitchen/kitchen.xml", "sky, steel, lacquer", judges=True),
    "classroom": Source(CHOI, "scenes/classroom/scene.xml", "sun through windows", judges=True),
    "bathroom": Source(CHOI, "scenes/bathroom/scene.xml", "one lamp, mirror, masks", judges=True),
    "bathroom2": Source(CHOI, "scenes/bathroom2/scene.xml", "bulbs in glass", judges=True),
    "living-room-2": Source(CHOI, "scenes/living-room-2/scene.xml", "four lamps", judges=True),
    "glass": Source(CHOI, "scenes/glass/scene.xml", "tumbler, ice, brushed metal", judges=True),
    "torus": Source(CHOI, "scenes/torus/scene.xml", "sun through glass", judges=True),
}

# As Mitsuba 3 reads its direction, the file's own sun is below the horizon.
SUNS = {"classroom": "0.4, 0.5, 0.6"}


def main() -> None:
    """Make the folders of the rooms."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("rooms", nargs="*", default=list(ROOMS))
    arguments = parser.parse_args()
    for name in arguments.rooms:
        target = arguments.folder / name
        extract(clone(ROOMS[name].repository, arguments.folder / "clones"), ROOMS[name], target)
        print(f"{name}: {ROOMS[name].what}")
        changes = Counter(mend(target / "scene.xml", SUNS.get(name)))
        for change, times in changes.items():
            print(f"    {change}" + (f" ({times} times)" if times > 1 else ""))


def clone(repository: str, folder: Path) -> Path:
    """The git directory of a repository."""
    found = folder / repository.replace("/", "+")
    if not found.exists():
        address = f"https://github.com/{repository}.git"
        subprocess.run(["git", "clone", "--bare", "--depth", "1", address, str(found)], check=True)
    return found


def extract(git: Path, source: Source, target: Path) -> None:
    """Write the files of a room, except those missing from the clone."""

    def run(*words: str) -> subprocess.CompletedProcess[bytes]:
        return subprocess.run(["git", f"--git-dir={git}", *words], capture_output=True)

    place = str(Path(source.file).parent)
    names = run("ls-tree", "-r", "--name-only", "-z", "HEAD", place).stdout.decode().split("\0")
    for name in filter(None, names):
        own = name == source.file
        if name.endswith(".xml") and not own:
            continue
        file = target / ("scene.xml" if own else Path(name).relative_to(place))
        if own or not file.exists():
            found = run("cat-file", "blob", f"HEAD:{name}")
            if found.returncode == 0:
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(found.stdout)


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
            raise SystemExit(f"{file}: {message}")
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


if __name__ == "__main__":
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    main()
