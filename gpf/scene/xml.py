"""Scene files read without Mitsuba: their tags with file and line, and the files they refer to.

Names are looked up where Mitsuba 3.9 looks:

- ``<include>``: beside the file that has the tag, then where that file was included from;
- ``<spectrum filename="...">``: where the file was included from, else beside the scene file;
- ``<string name="filename">``: plugins read it after everything is included, so beside the scene
  file, whichever file has the tag;
- a ``<path>`` comes before all of these in the file that has it, and for plugins if that is the
  scene file.

Mitsuba also looks in the current folder; here a file that is found there alone is missing, for it
is no part of the scene.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.parsers import expat

from gpf.core.errors import UserError

_DOLLAR = r"(?<!\\)\$"  # that begins a parameter


@dataclass(frozen=True)
class Place:
    """A line of a file; as text ``scene.xml:12``."""

    file: Path
    line: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


@dataclass(frozen=True)
class Tag:
    """A tag and its attributes, in which parameters such as ``$spp`` have their default values.

    ``is_root`` is true for the outermost tag of a file.
    """

    name: str
    attributes: Mapping[str, str]
    place: Place
    is_root: bool


@dataclass(frozen=True)
class Reference:
    """A file or, from a ``<path>``, a folder that a scene file names.

    Attributes
    ----------
    text: the name as it is written, parameters filled in.
    path: what Mitsuba reads; where nothing is there, where it would have to be.
    """

    text: str
    path: Path
    place: Place
    is_folder: bool = False


@dataclass
class SceneXml:
    """A scene file and those that it includes.

    Attributes
    ----------
    tags: all of them, in the order in which Mitsuba reads them; the first is the scene's own.
    references: the files that they name, included ones too, each once per tag that names it.
    defaults: what ``<default>`` gives to parameters.
    parameters: every ``$name`` that occurs, defined or not.
    """

    tags: list[Tag] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)
    defaults: dict[str, str] = field(default_factory=dict)
    parameters: set[str] = field(default_factory=set)

    def files(self) -> list[Path]:
        """Each file that is referred to once, in order."""
        return list(dict.fromkeys(r.path for r in self.references if not r.is_folder))

    def missing(self) -> list[Reference]:
        """The references behind which there is nothing, each path once."""
        found = {r.path: r for r in reversed(self.references) if not r.path.exists()}
        return list(reversed(found.values()))

    def fill(self, text: str) -> str:
        """Put default values in the place of parameters, the longest name that fits first.

        An undefined one stays as it is: Mitsuba objects to it, with its line.
        """
        if "$" not in text:
            return text
        for name in sorted(self.defaults, key=len, reverse=True):
            text = self.defaults[name].join(re.split(rf"{_DOLLAR}{re.escape(name)}", text))
        return text

    def is_defined(self, text: str) -> bool:
        """Whether all parameters in a text have values."""
        return re.search(_DOLLAR, self.fill(text)) is None


def read_scene_xml(file: Path) -> SceneXml:
    """Read a scene file and, where they exist, the files that it includes.

    Raises
    ------
    UserError: a file cannot be read, does not parse, or includes itself.
    """
    return _Reader(file).document


class _Reader:
    """Walks through files as Mitsuba does."""

    def __init__(self, file: Path) -> None:
        self.document = SceneXml()
        self.plugins: list[int] = []  # references that plugins look up
        search = [file.parent]
        self.read(file, search, ())
        references = self.document.references
        for i in self.plugins:  # now that `search` is complete
            references[i] = replace(references[i], path=_find(references[i].text, search))

    def read(self, file: Path, search: list[Path], within: tuple[Path, ...]) -> None:
        """Add a file; ``search`` is where it looks for names, its last resort last."""
        document = self.document
        for number, (name, raw, line) in enumerate(_parse(file)):
            place = Place(file, line)
            for text in raw.values():
                document.parameters |= set(re.findall(rf"{_DOLLAR}(\w+)", text))
            attributes = {k: document.fill(text).replace("\\$", "$") for k, text in raw.items()}
            document.tags.append(Tag(name, attributes, place, is_root=number == 0))
            value, filename = attributes.get("value", ""), attributes.get("filename", "")
            if name == "default":
                document.defaults.setdefault(attributes.get("name", ""), value)
            elif not all(document.is_defined(text) for text in raw.values()):
                continue
            elif name == "string" and attributes.get("name") == "filename":
                self.plugins.append(len(document.references))
                document.references.append(Reference(value, search[-1] / value, place))
            elif name == "spectrum" and filename:
                document.references.append(Reference(filename, _find(filename, search), place))
            elif name == "path":
                folder = _find(value, [file.parent, *search], 0)
                document.references.append(Reference(value, folder, place, is_folder=True))
                search.insert(0, folder)
            elif name == "include":
                inner = [file.parent, *search]
                included = _find(filename, inner, 0)
                document.references.append(Reference(filename, included, place))
                chain = (*within, file.resolve())
                if included.resolve() in chain:
                    raise UserError(
                        str(place), f"includes {included}, which includes it", "Break the circle."
                    )
                if included.is_file():
                    self.read(included, inner, chain)


def _find(text: str, folders: Iterable[Path], otherwise: int = -1) -> Path:
    """``text`` in the first of the folders that has it, or in the one numbered ``otherwise``."""
    places = [folder / text for folder in folders]
    return next((path for path in places if path.exists()), places[otherwise])


def _parse(file: Path) -> list[tuple[str, dict[str, str], int]]:
    """Name, attributes and line of every tag of a file, in order."""
    tags: list[tuple[str, dict[str, str], int]] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda name, attributes: tags.append(
        (name, attributes, parser.CurrentLineNumber)
    )
    try:
        with file.open("rb") as stream:
            parser.ParseFile(stream)
    except OSError as error:
        raise UserError(str(file), "cannot be read", "Check the path.") from error
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise UserError(str(file), f"does not parse: {error}", "Correct the XML.") from error
    return tags
