"""Read hand-written YAML files, check them against a model, and explain errors in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from reprlib import Repr
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, NodeEvent, ScalarEvent

from gpf.core.errors import UserError

Model = TypeVar("Model", bound=BaseModel)

MOST_REPEATED = 100_000
"""Characters that aliases (``&a``, ``*a``) may add to a document. Without a limit, 300 bytes can
expand to gigabytes when the document is written or traversed."""

# Formats only as much of a value as a message shows.
_SHORT = Repr()
_SHORT.maxlevel = 3
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 60
_SHORT.maxdict = _SHORT.maxlist = _SHORT.maxtuple = 20


def suggest(word: str, known: Sequence[str], introduction: str) -> str:
    """The closest known word, if any is close, then ``introduction`` and all known words.

    ``suggest("prot", ["port", "host"], "Keys are")`` is "Did you mean 'port'? Keys are port, host."
    """
    close = get_close_matches(word, known, n=1)
    question = f"Did you mean {close[0]!r}? " if close else ""
    return f"{question}{introduction} {', '.join(known) if known else 'none'}."


def read_yaml(file: Path, model: type[Model], if_missing: str) -> Model:
    """Read a YAML file into a model.

    The model forbids unknown keys. Its own validators may raise a ``PydanticCustomError`` whose
    ``{"todo": ...}`` tells the user what to do.

    Raises
    ------
    UserError: the first error in the file: it cannot be read (``if_missing`` then tells what
        to do), it is not YAML, or a key is repeated, unknown, missing or has a bad value.
    """
    try:
        data = load_yaml(file.read_text(encoding="utf-8"), str(file))
    except OSError as error:
        raise UserError(str(file), "cannot be read", if_missing) from error
    except UnicodeDecodeError as error:
        raise _not_yaml(str(file), error) from error
    try:
        return model.model_validate({} if data is None else data)
    except ValidationError as error:
        raise explain(str(file), model, error) from error


def load_yaml(text: str, source: str, yaml: YAML | None = None) -> Any:
    """Load the content of a document.

    Parameters
    ----------
    source: the file, for messages.
    yaml: the loader; the safe one by default.

    Raises
    ------
    UserError: it is not YAML, or its aliases repeat more than :data:`MOST_REPEATED` characters.
    """
    try:
        if "*" in text:
            _check_repetitions(text, source)
        return (yaml or YAML(typ="safe")).load(text)
    # ValueError: a number with thousands of digits. RecursionError: too deep.
    except (YAMLError, ValueError, RecursionError) as error:
        raise _not_yaml(source, error) from error


def _not_yaml(source: str, error: Exception) -> UserError:
    what = " ".join(str(error).split())
    return UserError(source, f"is not YAML: {what}", "Correct that line.")


def _check_repetitions(text: str, source: str) -> None:
    """Raise a :class:`UserError` if aliases make a document too long, or endless.

    This expands nothing. For a merge key (``<<``), only its alias would be written.
    """
    sizes: dict[str, int] = {}  # of complete nodes with anchors: characters, at least 1 per node
    begun: list[tuple[str | None, int]] = [(None, 0)]  # anchors and sizes of incomplete nodes
    repeated = 0
    for event in YAML(typ="safe").parse(text):
        if isinstance(event, CollectionEndEvent):
            name, size = begun.pop()
        elif isinstance(event, ScalarEvent):
            name, size = event.anchor, 1 + len(event.value)
        elif isinstance(event, AliasEvent):
            name, size = None, sizes.get(event.anchor, 0)  # the loader reports an unknown one
            repeated += size
            if event.anchor in (open_name for open_name, _ in begun):
                raise UserError(source, f"uses *{event.anchor} inside itself", "Write it out.")
            if repeated > MOST_REPEATED:
                what = f"repeats more than {MOST_REPEATED:,} characters through aliases such as "
                raise UserError(source, f"{what}*{event.anchor}", "Repeat less, or write it out.")
        elif isinstance(event, NodeEvent):
            begun.append((event.anchor, 1))
            continue
        else:
            continue
        if name is not None:
            sizes[name] = size
        outer, before = begun.pop()
        begun.append((outer, before + size))


def explain(source: str, model: type[BaseModel], error: ValidationError) -> UserError:
    """Explain the first validation error of ``source`` in plain words."""
    first = error.errors()[0]
    place, known = _place(model, first["loc"])
    where = f"{source}: {'.'.join(place)}" if place else source
    if first["type"] == "extra_forbidden":
        return UserError(where, "is an unknown key", suggest(place[-1], known, "Known keys are"))
    if first["type"] == "missing":
        return UserError(where, "is missing", "Add it.")
    todo = first.get("ctx", {}).get("todo")
    if todo is not None:
        return UserError(where, first["msg"], todo)
    value = _SHORT.repr(first["input"])
    value = value if len(value) <= 60 else f"{value[:57]}..."
    return UserError(where, f"is {value}", f"{first['msg']}.")


def _place(model: type[BaseModel], loc: Sequence[str | int]) -> tuple[list[str], list[str]]:
    """The keys and indices in ``loc``, and the known keys beside the last one.

    Pydantic's ``loc`` also names the chosen member of a union, which does not occur in the file.
    """
    schema = model.model_json_schema()
    node: Mapping[str, Any] = schema
    place: list[str] = []
    known: list[str] = []
    for part in loc:
        options = [option for option in (node, *node.get("anyOf", ())) if "$ref" in option]
        if options:
            node = schema["$defs"][options[0]["$ref"].rpartition("/")[2]]
        members = node.get("discriminator", {}).get("mapping", {})
        if part in members:
            node = {"$ref": members[part]}
        elif node.get("type") in ("object", "array"):
            place.append(str(part))
            keys, patterns = node.get("properties", {}), node.get("patternProperties", {})
            known = sorted(keys)
            inner = (keys.get(part), *patterns.values(), node.get("additionalProperties"))
            node = next((n for n in (*inner, node.get("items")) if isinstance(n, dict)), {})
    return place, known
