"""YAML files that people write: read, checked against a model, with errors in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from gpf.core.errors import UserError

Model = TypeVar("Model", bound=BaseModel)


def suggest(word: str, known: Sequence[str], introduction: str) -> str:
    """The known word that is closest, if one is close, then ``introduction`` and all known words.

    ``suggest("prot", ["port", "host"], "Keys are")`` is "Did you mean 'port'? Keys are port, host."
    """
    close = get_close_matches(word, known, n=1)
    question = f"Did you mean {close[0]!r}? " if close else ""
    return f"{question}{introduction} {', '.join(known) if known else 'none'}."


def read_yaml(file: Path, model: type[Model], if_missing: str) -> Model:
    """Read a YAML file into a model.

    The model forbids unknown keys. Its own validators may raise a ``PydanticCustomError`` that
    tells the user what to do: ``{"todo": ...}``.

    Raises
    ------
    UserError: the first error in the file: it cannot be read (then ``if_missing`` tells what to
        do), it is not YAML, or a key is repeated, unknown, missing or has a bad value.
    """
    try:
        data = YAML(typ="safe").load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(str(file), "cannot be read", if_missing) from error
    # ValueError: no UTF-8, or a number of thousands of digits. RecursionError: too deep.
    except (YAMLError, ValueError, RecursionError) as error:
        what = " ".join(str(error).split())
        raise UserError(str(file), f"is not YAML: {what}", "Correct that line.") from error
    try:
        return model.model_validate({} if data is None else data)
    except ValidationError as error:
        raise explain(str(file), model, error) from error


def explain(source: str, model: type[BaseModel], error: ValidationError) -> UserError:
    """The first validation error of ``source`` in plain words."""
    first = error.errors()[0]
    place, known = _place(model, first["loc"])
    where = f"{source}: {'.'.join(place)}" if place else source
    if first["type"] == "extra_forbidden":
        return UserError(where, "is an unknown key", suggest(place[-1], known, "Known here are"))
    if first["type"] == "missing":
        return UserError(where, "is missing", "Add it.")
    todo = first.get("ctx", {}).get("todo")
    if todo is not None:
        return UserError(where, first["msg"], todo)
    value = repr(first["input"])
    value = value if len(value) <= 60 else f"{value[:57]}..."
    return UserError(where, f"is {value}", f"{first['msg']}.")


def _place(model: type[BaseModel], loc: Sequence[str | int]) -> tuple[list[str], list[str]]:
    """The keys and indices in ``loc``, and the known keys beside the last one.

    Pydantic's ``loc`` also names the chosen member of a union, which the file does not have.
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
