"""Profiles: sets of sizes that are written into params.yaml; comments and other keys stay."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedSeq

from gpf.core.errors import UserError
from gpf.core.files import write_text
from gpf.core.progress import say
from gpf.core.yaml import explain, load_yaml, suggest
from stages.config.params import Params, read_params

# Value of `ablations.run` that stands for all rows of `ablations.variants`.
EVERY = "all"


def read_profiles() -> Mapping[str, Mapping[str, Any]]:
    """Profile name -> dotted key of params.yaml -> value, for each key of any profile; a key that a
    profile lacks gets the default of the settings."""
    own = Path(__file__).with_suffix(".yaml")
    text = own.read_text(encoding="utf-8")
    differing: Mapping[str, Mapping[str, Any]] = load_yaml(text, str(own))
    defaults = {key: _default(key) for profile in differing.values() for key in profile}
    return {name: {**defaults, **profile} for name, profile in differing.items()}


def _default(key: str) -> Any:
    """The default of a dotted key of params.yaml, as a YAML value."""
    section, _, leaf = key.partition(".")
    value = getattr(Params.model_fields[section].default, leaf)
    return list(value) if isinstance(value, tuple) else value


def apply_profile(name: str, file: Path = Path("params.yaml")) -> None:
    """Write a profile's values into ``file``, and print each value that changed.

    Raises
    ------
    UserError: there is no such profile, or the result is not valid.
    """
    profiles = read_profiles()
    if name not in profiles:
        raise UserError(
            f"profile {name!r}", "does not exist", suggest(name, list(profiles), "Profiles are")
        )
    read_params(file)
    yaml, document = open_yaml(file.read_text(encoding="utf-8"), str(file))
    changes = []
    for key, value in profiles[name].items():
        section, _, leaf = key.partition(".")
        if value == EVERY:
            value = list(document.get(section, {}).get("variants", {}))
        # Only scenes and methods that this params.yaml has.
        if leaf == "scenes":
            value = [scene for scene in value if scene in document["scenes"]]
        if key in ("methods.learned", "animation.methods"):
            value = [row for row in value if row == "gpf" or row in document["baselines"]]
        before = document[section][leaf] if leaf in document.setdefault(section, {}) else None
        if before != value:
            document[section][leaf] = in_one_line(value)
            changes.append(f"{key}: {before} -> {value}")
    try:
        Params.model_validate(load_yaml(dump_yaml(yaml, document), str(file)))
    except ValidationError as error:
        raise explain(f"{file}, with profile {name}", Params, error) from error
    for change in changes:
        say(change)
    if changes:
        write_text(file, dump_yaml(yaml, document))
    say(f"{file}: profile {name}, {len(changes)} values changed")


def in_one_line(value: Any) -> Any:
    """The value; a list gets the style [a, b]."""
    if isinstance(value, list):
        value = CommentedSeq(value)
        value.fa.set_flow_style()
    return value


def open_yaml(text: str, source: str) -> tuple[YAML, Any]:
    """A document that keeps its comments, and the YAML object for :func:`dump_yaml`.

    ``source``: the file, for messages.
    """
    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.width = 200  # a list stays on one line
    yaml.indent(mapping=2, sequence=4, offset=2)  # as params.yaml is written
    return yaml, load_yaml(text, source, yaml)


def dump_yaml(yaml: YAML, document: Any) -> str:
    """The document as text."""
    stream = io.StringIO()
    yaml.dump(document, stream)
    return stream.getvalue()
