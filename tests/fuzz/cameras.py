"""Files of cameras: views.yaml and transforms.json."""

from __future__ import annotations

import io
import json
import random
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from tests.fuzz import meshes, odd
from tests.fuzz.case import Case
from tests.fuzz.texts import TRANSFORMS, VIEWS

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
    *(
        BOMB.encode() + b"views: *n8\n",
        MERGED.encode(),
        b"views: 2026-01-01\n",
        b"x: 1:2:3:4:5:6:7:8:9",
    ),
    *(b"[" * 3000, b"{a: " * 3000, b"- " * 3000, b"x: " + b"9" * 5000, b"null: 1\n", b"1: 2\n"),
    *(b"<<: 1\n", b"<<: [a, b]\n", b"x: *nobody\n", b"x: 0o9\n", b"x: .inf\n"),
)
JSONS = (
    b"", b"null", b"[]", b"{", b"\xff\xfe{", b"[" * 100_000, b'{"frames": ' * 5000, b"9" * 5000,
    b'{"frames": [1]}', b'{"frames": {}}', b'{"frames": "abc"}', b'{"\\ud800": 1}', b"NaN",
    b'\xef\xbb\xbf{"frames": []}', '{"frames": [{"é": 1}]}'.encode("latin-1"),
    '{"frames": []}'.encode("utf-16"),
)  # fmt: skip


def dump(tree: Any) -> bytes:
    """Nested data as YAML."""
    stream = io.StringIO()
    YAML(typ="safe").dump(tree, stream)
    return stream.getvalue().encode()


def changed_yaml(rng: random.Random, text: str) -> bytes:
    """A YAML file with faults in its values, its text or its form."""
    way = rng.random()
    if way < 0.7:
        return dump(odd.change_tree(rng, YAML(typ="safe").load(text), rng.choice([0, 1, 1, 1, 2])))
    if way < 0.85:
        return odd.change_bytes(rng, text.encode(), rng.randint(1, 4))
    return rng.choice(YAMLS)


def changed_json(rng: random.Random, tree: Any) -> bytes:
    """The same of a JSON file."""
    way = rng.random()
    if way < 0.7:
        text = json.dumps(odd.change_tree(rng, tree, rng.choice([0, 1, 1, 1, 2])))
        return text.encode()
    if way < 0.85:
        return odd.change_bytes(rng, json.dumps(tree).encode(), rng.randint(1, 4))
    return rng.choice(JSONS)


def make_case(rng: random.Random, folder: Path, good: Path) -> Case:
    """`gpf render` with a file of cameras."""
    for name in ("scene.xml", "field.safetensors"):
        (folder / name).symlink_to(good / name)
    words = ["render", "scene.xml", "--size", "4", "--spp", "1", "--no-denoise"]
    if rng.random() < 0.5:
        (folder / "views.yaml").write_bytes(changed_yaml(rng, VIEWS))
        words += rng.choice(
            [
                [],
                ["--frames", "all"],
                ["--frames", "1:2"],
                ["--view", "left"],
                ["--views", "views.yaml"],
            ]
        )
        return Case(tuple(words), ("pictures/*",), ("views.yaml", "view '"))
    tree = json.loads(json.dumps(TRANSFORMS))
    if rng.random() < 0.3:  # the size is that of the pictures
        del tree["w"], tree["h"]
        for frame in tree["frames"]:
            (folder / frame["file_path"]).write_bytes(meshes.png(rng, 0.3))
    (folder / "cameras.json").write_bytes(changed_json(rng, tree))
    words += ["--views", "cameras.json"]
    return Case(tuple(words), ("pictures/*",), ("cameras.json", ".png"))
