"""YAML files that people write: read, checked against a model, and objected to in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from gpf.core.errors import UserError

Model = TypeVar("Model", bound=BaseModel)


def suggest(word: str, known: Sequence[str], introduction: str) -> str:
    """A line for the user: the known word that is closest, if any is close, and all known ones."""
    close = get_close_matches(word, known, n=1)
    question = f"Did you mean {close[0]!r}? " if close else ""
    return f"{question}{introduction} {', '.join(known) if known else 'none'}."


def read_yaml(file: Path, model: type[Model], if_missing: str) -> Model:
    """Read a YAML file into a model.

    The model forbids keys that it does not know. A validator of its own that raises a
    ``PydanticCustomError`` may give what the user can do as ``{"todo": ...}``.

    Raises
    ------
    UserError: the file is missing (then ``if_missing`` says what to do), is not YAML, repeats a
        key, has an unknown key, lacks one or has a value out of range. The first of these is told.
    """
    try:
        data = YAML(typ="safe").load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(str(file), "cannot be read", if_missing) from error
    except (YAMLError, UnicodeDecodeError) as error:
        what = " ".join(str(error).split())
        raise UserError(str(file), f"is not YAML: {what}", "Correct that line.") from error
    try:
        return model.model_validate({} if data is None else data)
    except ValidationError as error:
        raise explain(str(file), model, error) from error


def explain(source: str, model: type[BaseModel], error: ValidationError) -> UserError:
    """The first of the objections to what ``source`` says, in words."""
    first = error.errors()[0]
    place, here = _follow(model, first["loc"])
    where = f"{source}: {'.'.join(place)}" if place else source
    if first["type"] == "extra_forbidden":
        return UserError(where, "is an unknown key", suggest(place[-1], here, "Known here are"))
    if first["type"] == "missing":
        return UserError(where, "is missing", "Add it.")
    todo = first.get("ctx", {}).get("todo")
    if todo is not None:
        return UserError(where, first["msg"], todo)
    arrived = repr(first["input"])
    arrived = arrived if len(arrived) <= 60 else f"{arrived[:57]}..."
    return UserError(where, f"is {arrived}", f"{first['msg']}.")


def _follow(model: type[BaseModel], path: Sequence[str | int]) -> tuple[list[str], list[str]]:
    """A place in the data as its file has it, and the keys that are known where it ends.

    Pydantic's places also name which part of a union was meant; files do not.
    """
    here: object = model
    place, known = [], sorted(model.model_fields)
    for part in path:
        models = list(_models_in(here))
        known = sorted({key for m in models for key in m.model_fields})
        tagged = [m for m in models if len(models) > 1 and _is_tagged(m, part)]
        if tagged and not _is_collection(here):
            here = tagged[0]
            continue
        if not models and not _is_collection(here) and isinstance(part, str):
            continue  # which kind of value of several
        place.append(str(part))
        if _is_collection(here):
            here = _without_wrapping(here)
            here = get_args(here)[1 if get_origin(here) is dict else 0]
        else:
            fields = [m.model_fields[part].annotation for m in models if part in m.model_fields]
            here = next(iter(fields), None)
    return place, known


def _without_wrapping(annotation: object) -> object:
    """What an annotation such as ``Annotated[dict[str, Model], ...] | None`` wraps."""
    while get_origin(annotation) not in (dict, list, tuple):
        parts = [a for a in get_args(annotation) if any(_models_in(a))]
        if not parts or isinstance(annotation, type):
            return annotation
        annotation = parts[0]
    return annotation


def _is_collection(annotation: object) -> bool:
    """Whether it stands for a dictionary or list of models."""
    return get_origin(_without_wrapping(annotation)) in (dict, list, tuple)


def _is_tagged(model: type[BaseModel], tag: object) -> bool:
    """Whether the tag is what tells this model from the others of a union."""
    kinds = [field.annotation for field in model.model_fields.values()]
    return any(get_origin(kind) is Literal and tag in get_args(kind) for kind in kinds)


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    """The models inside an annotation such as ``tuple[Annotated[View, ...], ...] | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    else:
        for part in get_args(annotation):
            yield from _models_in(part)
