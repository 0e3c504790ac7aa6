"""Read scene files without Mitsuba: their tags with file and line, and the files that they name.

``mi.parser`` is not suitable: it raises an error at the first missing include, folder or spectrum
file and at a parameter without a value, and its nodes do not keep ``<include>``, ``<path>``,
``<default>`` or the file name of a ``<spectrum>``.

File names are resolved as in Mitsuba 3.9:

- ``<include>``: in the folder of the file with the tag, then in those of the files that include it;
- ``<spectrum filename="...">``: only in the folders of the files that include the file with the
  tag; in the scene file, in its own folder;
- ``<string name="filename">``: plugins read it after all includes, so in the folder of the scene
  file, whichever file has the tag;
- a ``<path>`` adds its folder before those of the including files; one in the scene file also
  applies to all plugins.

Mitsuba also looks in the current folder. A file found only there counts as missing here, because it
is not part of the scene.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.parsers import expat

from gpf.core.errors import UserError

CODINGS = ("utf-8", "utf8", "utf-16", "iso-8859-1", "latin1", "us-ascii", "ascii")

DEEPEST_INCLUDE = 14
"""Maximum depth of includes below the first file; Mitsuba refuses more."""

MOST_CHARACTERS = 100_000
"""Maximum length of an attribute with its parameters replaced by their values: otherwise, a few
lines of nested parameters could fill the memory."""

_DOLLAR = r"(?<!\\)\$"  # starts a parameter name


@dataclass(frozen=True)
class Place:
    """A line of a file; ``str`` gives ``scene.xml:12``."""

    file: Path
    line: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


@dataclass(frozen=True)
class Tag:
    """A tag and its attributes; parameters such as ``$spp`` are replaced by their default values.

    ``is_root`` is true for the outermost tag of a file.
    """

    name: str
    attributes: Mapping[str, str]
    place: Place
    is_root: bool


@dataclass(frozen=True)
class Reference:
    """A file that a scene file names, or a folder that a ``<path>`` names.

    Attributes
    ----------
    text: the name in the scene file; parameters have their default values.
    path: the file or folder that Mitsuba reads; if it is missing, where it should be.
    place: the line that names it.
    """

    text: str
    path: Path
    place: Place
    is_folder: bool = False


@dataclass
class SceneXml:
    """A scene file and the files that it includes.

    Attributes
    ----------
    tags: all tags in the order in which Mitsuba reads them; the first is the root of the scene.
    references: the files that the tags name, one entry per tag; includes are among them.
    defaults: parameters and their values from ``<default>``.
    parameters: the names of all parameters in the files, with or without a default value.
    """

    tags: list[Tag] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)
    defaults: dict[str, str] = field(default_factory=dict)
    parameters: set[str] = field(default_factory=set)

    def files(self) -> list[Path]:
        """All files that the tags name, each once, in order."""
        return list(dict.fromkeys(r.path for r in self.references if not r.is_folder))

    def missing(self) -> list[Reference]:
        """The references whose file or folder does not exist, each path once."""
        found = {r.path: r for r in reversed(self.references) if not r.path.exists()}
        return list(reversed(found.values()))

    def fill(self, text: str) -> str:
        """Replace parameters by their default values; the longest matching name takes precedence.

        A parameter without a value stays as it is: Mitsuba raises an error with its line.

        Raises
        ------
        ValueError: the result has more than :data:`MOST_CHARACTERS`.
        """
        if "$" not in text:
            return text
        for name in sorted(self.defaults, key=len, reverse=True):
            value, parts = self.defaults[name], re.split(rf"{_DOLLAR}{re.escape(name)}", text)
            if len(text) + len(value) * (len(parts) - 1) > MOST_CHARACTERS:
                raise ValueError(f"more than {MOST_CHARACTERS:,} characters")
            text = value.join(parts)
        return text

    def is_defined(self, text: str) -> bool:
        """Whether all parameters in a text have default values."""
        return re.search(_DOLLAR, self.fill(text)) is None


def read_scene_xml(file: Path, parameters: Mapping[str, str] | None = None) -> SceneXml:
    """Read a scene file and all existing files that it includes.

    ``parameters``: values of parameters, by name, instead of the file's own.

    Raises
    ------
    UserError: a file cannot be read, does not parse, has a document type, or includes itself, or
        includes are nested too deep.
    """
    return _Reader(file, parameters or {}).document


class _Reader:
    """Reads files in Mitsuba's order."""

    def __init__(self, file: Path, parameters: Mapping[str, str]) -> None:
        self.document = SceneXml(defaults=dict(parameters))
        self.plugins: list[int] = []  # indices of the references that plugins resolve
        search = [file.parent]
        self.read(file, search, ())
        references = self.document.references
        for i in self.plugins:  # now that `search` is complete
            references[i] = replace(references[i], path=_find(references[i].text, search))

    def read(self, file: Path, search: list[Path], within: tuple[Path, ...]) -> None:
        """Add a file whose names are looked up in the folders ``search``, in order."""
        document = self.document
        for number, (name, raw, line) in enumerate(_parse(file)):
            place = Place(file, line)
            for text in raw.values():
                document.parameters |= set(re.findall(rf"{_DOLLAR}(\w+)", text))
            try:
                filled = {k: document.fill(text) for k, text in raw.items()}
            except ValueError as error:
                what = f"has {error} once its parameters are replaced"
                raise UserError(str(place), what, "Nest fewer parameters.") from None
            attributes = {k: text.replace("\\$", "$") for k, text in filled.items()}
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
                if included.is_file():  # false for a link to itself, which cannot be resolved
                    chain = (*within, file.resolve())
                    if included.resolve() in chain:
                        circle = f"includes {included}, which includes it"
                        raise UserError(str(place), circle, "Remove one include.")
                    if len(chain) > DEEPEST_INCLUDE:
                        deep = f"is nested in more than {DEEPEST_INCLUDE} includes"
                        raise UserError(str(place), deep, "Merge some of these files.")
                    self.read(included, inner, chain)


def _find(text: str, folders: Iterable[Path], otherwise: int = -1) -> Path:
    """``text`` in the first folder that contains it; if none does, in ``folders[otherwise]``."""
    places = [folder / text for folder in folders]
    return next((path for path in places if path.exists()), places[otherwise])


def _check_coding(file: Path, coding: str | None) -> None:
    # Mitsuba treats any other encoding as UTF-8, and Python cannot read ids that are not UTF-8.
    if coding and coding.lower() not in CODINGS and not file.read_bytes().isascii():
        todo = f"Save it as UTF-8, or as one of {', '.join(CODINGS)}."
        raise UserError(str(file), f"does not parse: unknown encoding {coding}", todo)


def _refuse_type(place: Place) -> None:
    raise UserError(str(place), "has a document type (DOCTYPE)", "Remove it and its entities.")


def _coding_of(file: Path) -> str | None:
    """The encoding of a file if expat does not know the name that the file gives it, or None."""
    try:
        with file.open("rb") as stream:
            head = stream.read(200)
    except OSError as error:
        raise UserError(str(file), "cannot be read", "Check the path.") from error
    return "utf-8" if re.match(rb"(?i)<\?xml[^>]*encoding=.utf8\W", head) else None


def _parse(file: Path) -> list[tuple[str, dict[str, str], int]]:
    """The name, attributes and line of each tag of a file, in order."""
    tags: list[tuple[str, dict[str, str], int]] = []
    parser = expat.ParserCreate(_coding_of(file))
    parser.StartElementHandler = lambda name, attributes: tags.append(
        (name, attributes, parser.CurrentLineNumber)
    )
    # Entities can expand to gigabytes or refer to other files, and scenes need none.
    parser.StartDoctypeDeclHandler = lambda *_: _refuse_type(Place(file, parser.CurrentLineNumber))
    parser.XmlDeclHandler = lambda _, coding, __: _check_coding(file, coding)
    try:
        with file.open("rb") as stream:
            parser.ParseFile(stream)
    except OSError as error:
        raise UserError(str(file), "cannot be read", "Check the path.") from error
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise UserError(str(file), f"does not parse: {error}", "Correct the XML.") from error
    return tags
