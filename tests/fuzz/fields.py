"""Fields' files: headers that lie, tensors of other shapes and types, values that are none."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save

from tests.fuzz import odd
from tests.fuzz.case import Case

KINDS = ("field", "compact", "levels")
TYPES = ("f4", "f8", "f2", "i4", "u1", "i8", "u2", "?")


def change_tensors(rng: random.Random, tensors: dict[str, np.ndarray]) -> None:
    """Change a tensor's values, type or shape, take it away, or give its name to another."""
    name = rng.choice(list(tensors))
    value = tensors[name].copy()
    way = rng.choice(["value", "value", "value", "all", "type", "drop", "rename", "shape", "rows"])
    if way in ("value", "all"):
        at: Any = ... if way == "all" else rng.randrange(value.size)
        with np.errstate(all="ignore"):
            number = odd.number(rng)
            if value.dtype.kind in "iu":
                number = np.uint8(rng.choice([0, 1, 2, 100, 127, 200, 255]))
            value.reshape(-1)[at] = np.float64(number).astype(value.dtype)
    elif way == "type":
        with np.errstate(all="ignore"):
            value = value.astype(rng.choice(TYPES))
    elif way == "shape":
        shapes = [(-1,), (1, -1), (value.size, 1), value.T.shape, (*value.shape, 1)]
        value = value.reshape(rng.choice(shapes))
    elif way == "rows":
        rows = rng.choice([0, 1, len(value) - 1, len(value) + 1])
        value = np.resize(value, (max(rows, 0), *value.shape[1:]))
    del tensors[name]
    if way != "drop":
        tensors[odd.text(rng) if way == "rename" else name] = value


def take_rows(rng: random.Random, tensors: dict[str, np.ndarray]) -> None:
    """Keep none or a few of the Gaussians."""
    count = rng.choice([0, 1, 2])
    for name, value in tensors.items():
        if name == "lights":
            tensors[name] = value[:, :count]
        elif name != "detail":
            tensors[name] = value[:count]


def changed_field(rng: random.Random, file: Path) -> bytes:
    """A field's file with faults."""
    with safe_open(str(file), framework="numpy") as opened:
        header = dict(opened.metadata())
        tensors = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
    way = rng.choice(["tensors", "tensors", "facts", "facts", "header", "bytes", "rows", "none"])
    if way == "tensors":
        for _ in range(rng.choice([1, 1, 2])):
            change_tensors(rng, tensors)
    elif way == "rows":
        take_rows(rng, tensors)
    elif way == "facts":
        facts = odd.change_tree(rng, json.loads(header["metadata"]), rng.choice([1, 1, 2]))
        header["metadata"] = json.dumps(facts)
    elif way == "header":
        key = rng.choice(list(header))
        header[key] = rng.choice([odd.text(rng), "{", "null", "[]", "9" * 5000, "[" * 100_000])
        if rng.random() < 0.3:
            del header[key]
    tensors = {name: np.ascontiguousarray(value) for name, value in tensors.items()}
    data = save(tensors, metadata=header)
    return change_file(rng, data) if way == "bytes" else data


def change_file(rng: random.Random, data: bytes) -> bytes:
    """Change the bytes of a file: its header's length, the header itself, or anything."""
    end = 8 + int.from_bytes(data[:8], "little")
    way = rng.choice(["length", "tree", "tree", "bytes", "cut"])
    if way == "length":
        length = rng.choice([0, 1, 7, end, 2**31, 2**40, 2**63, 2**64 - 1])
        return length.to_bytes(8, "little") + data[8:]
    if way == "cut":
        return data[: rng.randrange(len(data))]
    if way == "tree":
        text = json.dumps(odd.change_tree(rng, json.loads(data[8:end]))).encode()
        return len(text).to_bytes(8, "little") + text + data[end:]
    return odd.change_bytes(rng, data[: end + 200], 5) + data[end + 200 :]


def make_case(rng: random.Random, folder: Path, good: Path) -> Case:
    """A command that reads a field."""
    (folder / "scene.xml").symlink_to(good / "scene.xml")
    field = "field.safetensors"
    (folder / field).write_bytes(changed_field(rng, good / f"{rng.choice(KINDS)}.safetensors"))
    render = ("render", "scene.xml", "--changed-scene", "--size", "5x4", "--spp", "1")
    lights = rng.choice([(), (), ("--lights", "lamp=0.5"), ("--aovs", "error,irradiance")])
    words = rng.choice(
        [
            *[(*render, "--no-denoise", *lights)] * 3,
            ("export", field, "--ply", "out.ply"),
            ("export", field, "--compact", "out.safetensors"),
            ("lights", field),
            ("view", "scene.xml", "--field", field, "--no-open", "--changed-scene"),
        ]
    )
    return Case(words, ("pictures/*", "out.*"), (field, "lights: "))
