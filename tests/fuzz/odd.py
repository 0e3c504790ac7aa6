"""Values that nobody expects, and changes of text, bytes and nested data."""

from __future__ import annotations

import random
from collections.abc import Callable
from copy import deepcopy
from typing import Any

NUMBERS = (
    *(0, -1, 1, 0.5, 1e-30, -1e-3, 1e30, -1e30, 3.5e38, 1e300),
    *(2**31, 2**32, 2**63, 2**64, 10**30),
    *(float("nan"), float("inf"), float("-inf")),
)
TEXTS = (
    *("", " ", "a", "nan", "inf", "-1", "1e400", "0x10", "true", "null", "auto", "1,2", "1 2 3"),
    *("../../out", "/nowhere/out", "~", ".", "..", "\\", "%s", "$x", "${x}", "{}", "[", "]"),
    *("a" * 3000, "名前", "é", "\u202e", "\x7f", "🙂", "--help", "-", "con", "a\nb", "a\tb"),
)


def number(rng: random.Random) -> float | int:
    """A number that is hardly ever meant."""
    return rng.choice(NUMBERS)


def text(rng: random.Random) -> str:
    """A text that is hardly ever meant."""
    return rng.choice(TEXTS)


def value(rng: random.Random) -> Any:
    """A JSON value of any type."""
    makers: tuple[Callable[[], Any], ...] = (
        lambda: number(rng),
        lambda: text(rng),
        lambda: rng.choice([None, True, False]),
        lambda: [],
        lambda: {},
        lambda: [number(rng) for _ in range(rng.choice([1, 2, 3, 4, 16]))],
        lambda: {text(rng): number(rng)},
        lambda: [[]],
        lambda: [text(rng)] * 2,
    )
    return rng.choice(makers)()


def places(tree: Any) -> list[tuple[Any, Any]]:
    """Each container in nested data with one of its keys or indices."""
    keys = list(tree) if isinstance(tree, dict) else []
    keys = list(range(len(tree))) if isinstance(tree, list) else keys
    return [(tree, k) for k in keys] + [inner for k in keys for inner in places(tree[k])]


def change_tree(rng: random.Random, tree: Any, changes: int = 1) -> Any:
    """A copy of nested data in which a few parts are gone, doubled, renamed or something else."""
    tree = deepcopy(tree)
    for _ in range(changes):
        found = places(tree)
        if not found:
            return value(rng)
        place, key = rng.choice(found)
        way = rng.choice(["value", "value", "value", "drop", "double", "rename", "swap"])
        if way == "drop":
            del place[key]
        elif way == "double" and isinstance(place, list):
            place.insert(key, deepcopy(place[key]))
        elif way == "rename" and isinstance(place, dict):
            place[text(rng)] = place.pop(key)
        elif way == "swap":
            other, key2 = rng.choice(found)
            place[key] = deepcopy(other[key2])
        elif isinstance(place[key], int | float) and rng.random() < 0.7:
            place[key] = number(rng)
        else:
            place[key] = value(rng)
    return value(rng) if rng.random() < 0.03 else tree


def change_bytes(rng: random.Random, data: bytes, changes: int = 3) -> bytes:
    """Bytes with a few of them changed, cut out, put in or repeated; or cut off, or none at all."""
    if rng.random() < 0.03:
        return b""
    changed = bytearray(data)
    for _ in range(changes):
        at = rng.randrange(len(changed) + 1)
        length = rng.choice([1, 1, 1, 2, 8, 100])
        way = rng.choice(["flip", "flip", "cut", "insert", "repeat", "end"])
        if way == "flip" and at < len(changed):
            changed[at] ^= 1 << rng.randrange(8)
        elif way == "cut":
            del changed[at : at + length]
        elif way == "insert":
            changed[at:at] = rng.randbytes(length)
        elif way == "repeat":
            changed[at:at] = changed[at : at + length]
        elif way == "end" and rng.random() < 0.3:
            del changed[at:]
    return bytes(changed)
