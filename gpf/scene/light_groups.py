"""Emitter groups whose light is kept separate, so that it can be dimmed and coloured later."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import drjit as dr
import mitsuba as mi
import numpy as np
from pydantic import Field, RootModel

from gpf.core.errors import UserError
from gpf.core.structs import from_numpy
from gpf.core.yaml import read_yaml, suggest
from gpf.scene.views import name_view

MOST_GROUPS = 16
"""Largest number of groups: each costs memory and time."""


@dataclass(frozen=True)
class LightGroups:
    """Groups that together contain each emitter of a scene once.

    Attributes
    ----------
    names: names of the groups.
    members: for each group, the indices of its emitters in ``scene.emitters()``.
    emitters: for each group, the names of its emitters (:func:`emitter_names`); empty if unknown.
    """

    names: tuple[str, ...]
    members: tuple[tuple[int, ...], ...]
    emitters: tuple[tuple[str, ...], ...] = dataclasses.field(default=(), compare=False)

    @classmethod
    def parse(cls, text: str, scene: mi.Scene) -> LightGroups | None:
        """None for an empty text; a group per emitter for ``auto``; else the groups in a file.

        Raises
        ------
        UserError: as :meth:`each` and :meth:`read`.
        """
        if not text:
            return None
        return cls.each(scene) if text == "auto" else cls.read(Path(text), scene)

    @classmethod
    def each(cls, scene: mi.Scene) -> LightGroups:
        """One group per emitter.

        Raises
        ------
        UserError: there are more than :data:`MOST_GROUPS`.
        """
        names = emitter_names(scene)
        if len(names) > MOST_GROUPS:
            raise UserError(
                "--groups auto",
                f"would make {len(names)} groups, one per emitter; the limit is {MOST_GROUPS}",
                "List the groups in a file, such as `ceiling: [lamp_1, lamp_2]`.",
            )
        return cls._of(names, {name: (k,) for k, name in enumerate(names)})

    @classmethod
    def read(cls, file: Path, scene: mi.Scene) -> LightGroups:
        """The groups in a YAML file: names with lists of emitters (:func:`emitter_names`).

        Emitters that the file does not list form the group ``other``.

        Raises
        ------
        UserError: the file cannot be read, an emitter does not exist or is listed twice, or there
            are more than :data:`MOST_GROUPS` groups.
        """
        listed = read_yaml(file, _Listed, "Write one with lines such as `window: [sky]`.")
        known = emitter_names(scene)
        groups: dict[str, tuple[int, ...]] = {}
        taken: dict[str, str] = {}
        for name, emitters in listed.root.items():
            for emitter in emitters:
                if emitter not in known:
                    raise UserError(
                        f"{file}: {name}",
                        f"lists {emitter!r}, which is not an emitter",
                        suggest(emitter, known, "The emitters are"),
                    )
                if emitter in taken:
                    raise UserError(
                        f"{file}: {name}",
                        f"lists {emitter}, which is also in {taken[emitter]}",
                        "List each emitter once.",
                    )
                taken[emitter] = name
            groups[name] = tuple(known.index(emitter) for emitter in emitters)
        rest = tuple(k for k, emitter in enumerate(known) if emitter not in taken)
        if rest:
            groups[name_view("other", groups, "other")] = rest
        if len(groups) > MOST_GROUPS:
            raise UserError(
                str(file), f"has {len(groups)} groups", f"The limit is {MOST_GROUPS}: join some."
            )
        return cls._of(known, groups)

    @classmethod
    def _of(cls, known: Sequence[str], groups: Mapping[str, tuple[int, ...]]) -> LightGroups:
        named = tuple(tuple(known[k] for k in members) for members in groups.values())
        return cls(tuple(groups), tuple(groups.values()), named)

    def in_frame(self, scene: mi.Scene) -> LightGroups:
        """The same groups in another frame of an animation, whose emitters have the same names.
        Some may be missing. Groups that do not know the names are returned as they are.

        Raises
        ------
        UserError: an emitter of the frame is in no group, or one that may be any of several is
            missing.
        """
        if not self.emitters:
            return self
        known = emitter_names(scene)
        grouped = [name for names in self.emitters for name in names]
        for kind in _kinds_without_name(scene):
            alike = (name for name in grouped if re.fullmatch(rf"{kind}(_\d+)?", name))
            if missing := [name for name in alike if name not in known]:
                raise UserError(
                    f"emitter {missing[-1]}",
                    f"has no name of its own, and there are fewer {kind}s than in the first frame",
                    "Give these lamps ids, so that they can be told apart.",
                )
        if strangers := [name for name in known if name not in grouped]:
            raise UserError(
                f"emitter {strangers[0]}",
                "is in none of the groups, which are those of the first frame",
                "Give the first frame all emitters, with a radiance of 0 where they are off.",
            )
        members = tuple(
            tuple(known.index(name) for name in names if name in known) for names in self.emitters
        )
        return replace(self, members=members)

    def table(self, scene: mi.Scene) -> mi.UInt32:
        """Group numbers, indexed by an emitter's number in the registry; see :func:`group_of`."""
        ids = np.array(dr.reinterpret_array(mi.UInt32, scene.emitters_dr()))
        table = np.zeros(int(ids.max()) + 1, np.uint32)
        for number, members in enumerate(self.members):
            table[ids[list(members)]] = number
        return from_numpy(mi.UInt32, table)


class _Listed(
    RootModel[
        dict[
            Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]*$")],
            Annotated[list[str], Field(min_length=1)],
        ]
    ]
):
    """A file of groups."""


def group_of(table: mi.UInt32, emitter: mi.EmitterPtr) -> mi.UInt32:
    """The group of each emitter, (N,); ``table`` comes from :meth:`LightGroups.table`."""
    index = dr.reinterpret_array(mi.UInt32, emitter)
    return dr.gather(mi.UInt32, table, index, index < dr.width(table))


def emitter_names(scene: mi.Scene) -> list[str]:
    """A name for each of ``scene.emitters()``: its shape's id or its own, in lower case."""
    names: list[str] = []
    for emitter, name in zip(scene.emitters(), _own_names(scene), strict=True):
        names.append(name_view(name, names, otherwise=_kind(emitter)))
    return names


def _own_names(scene: mi.Scene) -> list[str]:
    """The id of each emitter's shape or its own, empty if it has none."""
    shapes = {shape.emitter(): shape.id() for shape in scene.shapes() if shape.is_emitter()}
    names = [shapes.get(emitter, "") or emitter.id() for emitter in scene.emitters()]
    return ["" if name.startswith(("_", "unnamed")) else name for name in names]


def _kind(emitter: mi.Emitter) -> str:
    return emitter.class_name().removesuffix("Emitter").lower() or "lamp"


def _kinds_without_name(scene: mi.Scene) -> set[str]:
    """The kinds of emitters that have no name of their own."""
    named = zip(scene.emitters(), _own_names(scene), strict=True)
    return {_kind(emitter) for emitter, name in named if not name}


# --- levels -----------------------------------------------------------------------------------

Levels = Mapping[str, tuple[float, float, float]]
"""Factors for the red, green and blue light of some groups; 1 for all others."""


def parse_levels(text: str, names: Sequence[str]) -> dict[str, tuple[float, float, float]]:
    """Levels from a text such as ``window=0.2,lamp=1.5,#ffd0a0``.

    A colour (sRGB) multiplies the level of the group before it.

    Raises
    ------
    UserError: a name does not exist, or a level is not a number of at least 0.
    """
    levels: dict[str, tuple[float, float, float]] = {}
    last = ""
    for part in filter(None, (part.strip() for part in text.split(","))):
        if part.startswith("#") and last:
            levels[last] = tuple(a * b for a, b in zip(levels[last], _colour(part), strict=True))  # type: ignore[assignment]
            continue
        last, equals, value = (word.strip() for word in part.partition("="))
        if last not in names:
            raise UserError(
                f"lights: {last}", "is not a group", suggest(last, list(names), "The groups are")
            )
        try:
            level = float(value)
        except ValueError:
            level = -1.0
        if not equals or not 0 <= level < float("inf"):
            raise UserError(
                f"lights: {part}", "is not a level", f"Write {last}=0.5, or {last}=1,#ffd0a0."
            )
        levels[last] = (level, level, level)
    return levels


def _colour(text: str) -> tuple[float, ...]:
    """Linear red, green and blue of a hexadecimal sRGB colour."""
    from gpf.core.images import undo_tone_map

    digits = text[1:]
    try:
        codes = [int(digits[k : k + 2], 16) for k in (0, 2, 4)]
    except ValueError:
        codes = []
    if len(digits) != 6 or len(codes) != 3:
        raise UserError(f"lights: {text}", "is not a colour", "Write it as #ffd0a0.")
    return tuple(float(v) for v in undo_tone_map(np.array(codes) / 255))
