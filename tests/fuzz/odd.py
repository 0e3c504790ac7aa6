"""Values that nobody expects, and changes of nested data and of bytes."""

from __future__ import annotations

import re
from copy import deepcopy
from typing import Any

from hypothesis import strategies as st

NUMBERS = st.sampled_from([
    *(0, -1, 1, 0.5, 1e-30, -1e-3, 1e30, -1e30, 3.5e38, 1e300, 1e12),
    *(60000, 10**6, 10**8, 2**31 - 1, 2**31, 2**32, 10**10, 2**63, 2**64, 10**30),
    *(float("nan"), float("inf"), float("-inf")),
])  # fmt: skip
TEXTS = st.text(max_size=9) | st.sampled_from([
    *("", " ", "a", "nan", "inf", "-1", "1e400", "0x10", "true", "null", "auto", "1,2", "1 2 3"),
    *("../../out", "/nowhere/out", "~", ".", "..", "\\", "%s", "$x", "${x}", "{}", "[", "]"),
    *("a" * 3000, "名前", "é", "\u202e", "\x7f", "🙂", "--help", "-", "con", "a\nb", "a\tb"),
])  # fmt: skip
VALUES = st.recursive(
    NUMBERS | TEXTS | st.none() | st.booleans(),
    lambda inner: st.lists(inner, max_size=16) | st.dictionaries(TEXTS, inner, max_size=2),
    max_leaves=16,
)


def rarely(draw: st.DrawFn, number: int) -> bool:
    """True once in so many times."""
    return draw(st.sampled_from([False] * (number - 1) + [True]))


def places_in(tree: Any) -> list[tuple[Any, Any]]:
    """Each container in nested data with one of its keys or indices."""
    keys = list(tree) if isinstance(tree, dict) else []
    keys = list(range(len(tree))) if isinstance(tree, list) else keys
    return [(tree, k) for k in keys] + [inner for k in keys for inner in places_in(tree[k])]


def changed_tree(draw: st.DrawFn, tree: Any, most: int = 2) -> Any:
    """Nested data in which a few parts are gone, doubled, renamed or something else."""
    tree = deepcopy(tree)
    for _ in range(draw(st.integers(0, most))):
        places = places_in(tree)
        if not places:
            return draw(VALUES)
        place, key = places[draw(st.integers(0, len(places) - 1))]
        old = place[key]
        way = draw(st.sampled_from(["number", "number", "value", "drop", "double", "name", "copy"]))
        if way == "drop":
            del place[key]
        elif way == "double" and isinstance(place, list):
            place.insert(key, deepcopy(old))
        elif way == "name" and isinstance(place, dict):
            place[draw(TEXTS)] = place.pop(key)
        elif way == "copy":
            other, there = places[draw(st.integers(0, len(places) - 1))]
            place[key] = deepcopy(other[there])
        elif way == "number" and isinstance(old, str) and (found := re.findall(r"-?[\d.]+", old)):
            place[key] = old.replace(draw(st.sampled_from(found)), str(draw(NUMBERS)), 1)
        elif way == "number" and isinstance(old, int | float):
            place[key] = draw(NUMBERS)
        else:
            place[key] = draw(VALUES)
    return draw(VALUES) if rarely(draw, 30) else tree


def changed_bytes(draw: st.DrawFn, data: bytes, most: int = 4) -> bytes:
    """Bytes of which a few are others, gone, doubled or in between; or cut off."""
    for _ in range(draw(st.integers(1, most))):
        at = draw(st.integers(0, len(data)))
        end = at + draw(st.sampled_from([1, 1, 0, 2, 8, 100, len(data)]))
        new = 2 * data[at:end] if rarely(draw, 3) else draw(st.binary(max_size=8))
        data = data[:at] + new + data[end:]
    return data
