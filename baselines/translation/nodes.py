"""The plugins of a scene with all their parameters, as Mitsuba's parser reads them.

A loaded scene does not tell the names of its plugins, nor parameters such as the distribution of a
rough surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi

Dict = dict[str, Any]
_Type = mi.Properties.Type


@dataclass(frozen=True)
class Node:
    """A plugin.

    Attributes
    ----------
    kind: what it is, such as a shape.
    plugin: its type in the scene file; this project's variants count as Mitsuba's.
    id: empty if the file gives none.
    values: its parameters, as `mi.load_dict` takes them.
    parts: the plugins that it refers to, in the file's order.
    """

    kind: mi.ObjectType
    plugin: str
    id: str
    values: Mapping[str, Any]
    parts: Mapping[str, Node]

    def of_kind(self, kind: mi.ObjectType) -> list[Node]:
        """The parts of a kind."""
        return [part for part in self.parts.values() if part.kind == kind]

    def as_dict(self, *left_out: mi.ObjectType) -> Dict:
        """For `mi.load_dict`, without parts of some kinds."""
        kept = {k: p.as_dict(*left_out) for k, p in self.parts.items() if p.kind not in left_out}
        return {"type": self.plugin, **self.values, **kept}


def read_file(file: Path) -> Node:
    """The scene of a file."""
    config = _make_config()
    before = mi.file_resolver()
    resolver = mi.FileResolver(before)
    resolver.prepend(str(file.parent))
    mi.set_file_resolver(resolver)
    try:
        state = mi.parser.parse_file(config, str(file))
        mi.parser.transform_all(config, state)
    finally:
        mi.set_file_resolver(before)
    return _read_state(state, file.parent)


def read_dict(scene: Mapping[str, Any]) -> Node:
    """The scene of a dictionary; its files are absolute, or relative to the current folder."""
    config = _make_config()
    state = mi.parser.parse_dict(config, dict(scene))
    mi.parser.transform_all(config, state)
    return _read_state(state, Path())


def _make_config() -> mi.parser.ParserConfig:
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_equivalent = config.merge_meshes = False
    return config


def _read_state(state: mi.parser.ParserState, folder: Path) -> Node:
    made: dict[int, Node] = {}

    def make(index: int) -> Node:
        if index not in made:
            node = state.nodes[index]
            props = node.props
            refers = [k for k in props if props.type(k) == _Type.ResolvedReference]
            made[index] = Node(
                node.type,
                props.plugin_name().removeprefix("separable_"),
                props.id(),
                {k: _read_value(props, k, folder) for k in props if k not in refers},
                {k: make(props[k].index()) for k in refers},
            )
        return made[index]

    return make(state.root.index() if hasattr(state.root, "index") else 0)


def _read_value(props: mi.Properties, key: str, folder: Path) -> Any:
    value, kind = props[key], props.type(key)
    if kind == _Type.Color:
        return {"type": "rgb", "value": [float(c) for c in value]}
    if kind == _Type.Spectrum:
        pairs = list(zip(value.wavelengths, value.values, strict=False))
        return {"type": "spectrum", "value": value.values[0] if value.is_uniform() else pairs}
    if key == "filename" and (folder / value).exists():
        return str((folder / value).resolve())
    return value
