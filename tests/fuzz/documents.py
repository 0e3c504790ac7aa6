"""YAML and JSON files with faults in their values, their text or their form."""

from __future__ import annotations

import io
import json
from typing import Any

from hypothesis import strategies as st
from ruamel.yaml import YAML

from tests.fuzz import odd

# Nine names, each a list of the one before nine times: 9^9 entries.
BOMB = "n0: &n0 [x]\n" + "".join(
    f"n{k}: &n{k} [{', '.join([f'*n{k - 1}'] * 9)}]\n" for k in range(1, 9)
)

# The same with merge keys.
MERGED = BOMB.replace("[x]", "{x: 1}").replace(" [*", " {<<: [*").replace("]\n", "]}\n")

YAMLS = (
    *(b"", b"- 1\n- 2\n", b"views", b"a: &x [*x]\n", b"a: &a [1]\nb: *a\n", b"? [a]\n: 1\n"),
    *(b"!!python/object/apply:os.system ['touch x']\n", b"views: !!binary aaaa\n", b"\x00"),
    *(b"a: 1\na: 2\n", b"\xff\xfe", b"\tviews: 1\n", b"--- 1\n--- 2\n", b"%YAML 9.9\n---\n"),
    *(BOMB.encode() + b"views: *n8\n", MERGED.encode(), b"views: 2026-01-01\n"),
    *(b"[" * 3000, b"{a: " * 3000, b"- " * 3000, b"x: " + b"9" * 5000, b"null: 1\n", b"1: 2\n"),
    *(b"<<: 1\n", b"<<: [a, b]\n", b"x: *nobody\n", b"x: 0o9\n", b"x: .inf\n"),
    b"x: 1:2:3:4:5:6:7:8:9",
)
JSONS = (
    *(b"", b"null", b"[]", b"{", b"\xff\xfe{", b"[" * 100_000, b'{"frames": ' * 5000, b"9" * 5000),
    *(b'{"frames": [1]}', b'{"frames": {}}', b'{"frames": "abc"}', b'{"\\ud800": 1}', b"NaN"),
    *(b'\xef\xbb\xbf{"frames": []}', '{"frames": [{"é": 1}]}'.encode("latin-1")),
    '{"frames": []}'.encode("utf-16"),
)


def to_yaml(tree: Any) -> bytes:
    """Nested data as YAML."""
    stream = io.StringIO()
    YAML(typ="safe").dump(tree, stream)
    return stream.getvalue().encode()


def to_json(tree: Any) -> bytes:
    """Nested data as JSON."""
    return json.dumps(tree).encode()


def changed_yaml(draw: st.DrawFn, text: str) -> bytes:
    """A YAML file with faults."""
    way = draw(st.integers(0, 5))
    if way < 4:
        return to_yaml(odd.changed_tree(draw, YAML(typ="safe").load(text)))
    return odd.changed_bytes(draw, text.encode()) if way == 4 else draw(st.sampled_from(YAMLS))


def changed_json(draw: st.DrawFn, tree: Any) -> bytes:
    """A JSON file with faults."""
    way = draw(st.integers(0, 5))
    if way < 4:
        return to_json(odd.changed_tree(draw, tree))
    return odd.changed_bytes(draw, to_json(tree)) if way == 4 else draw(st.sampled_from(JSONS))
