"""Fields' files: headers that lie, tensors of other shapes and types, values that are none."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from hypothesis import strategies as st
from safetensors.numpy import load, save

from tests.fuzz import odd
from tests.fuzz.case import Case
from tests.fuzz.good import SCENE, good_fields

TYPES = ("f4", "f8", "f2", "i4", "u1", "i8", "u2", "?")
WAYS = ("tensors",) * 4 + ("facts", "facts", "fact", "rows", "length", "header", "bytes")
LENGTHS = (0, 1, 7, 2**31, 2**40, 2**63, 2**64 - 1)
BAD_FACTS = odd.TEXTS | st.sampled_from(["{", "null", "[]", "9" * 5000, "[" * 100_000])
RENDER = "render scene.xml --changed-scene --size 5x4 --spp 1 --no-denoise"
COMMANDS = (
    *(RENDER, f"{RENDER} --lights lamp=0.5", f"{RENDER} --aovs error,irradiance"),
    "export field.safetensors --ply out.ply",
    "export field.safetensors --compact out.safetensors",
    "info field.safetensors",
    "view scene.xml --field field.safetensors --no-open --changed-scene",
)


def changed_tensors(draw: st.DrawFn, tensors: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Tensors of which one has another value, type or shape, or is not there."""
    name = draw(st.sampled_from(sorted(tensors)))
    value = tensors[name].copy()
    way = draw(st.sampled_from(["value", "value", "value", "type", "drop", "name", "shape"]))
    if way == "value" and value.size:
        at = draw(st.just(...) | st.integers(0, value.size - 1))
        numbers = st.integers(0, 255) if value.dtype.kind in "iu" else odd.NUMBERS
        value.reshape(-1)[at] = np.float64(draw(numbers)).astype(value.dtype)
    elif way == "type":
        value = value.astype(draw(st.sampled_from(TYPES)))
    elif way == "shape":
        rows = (draw(st.sampled_from([0, 1, len(value) - 1, len(value) + 1])), *value.shape[1:])
        shapes = [(value.size,), (1, value.size), value.T.shape, (*value.shape, 1), rows]
        value = np.resize(value, draw(st.sampled_from(shapes)))
    others = {key: tensors[key] for key in tensors if key != name}
    return (
        others if way == "drop" else {**others, draw(odd.TEXTS) if way == "name" else name: value}
    )


def first_rows(tensors: dict[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """None or a few of the Gaussians."""
    cut = {"lights": np.s_[:, :count], "detail": np.s_[:]}
    return {name: value[cut.get(name, np.s_[:count])] for name, value in tensors.items()}


def with_header(data: bytes, header: Any) -> bytes:
    """A field's file with another header."""
    end = 8 + int.from_bytes(data[:8], "little")
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data[end:]


def changed_field(draw: st.DrawFn, data: bytes) -> bytes:
    """A field's file with faults."""
    end = 8 + int.from_bytes(data[:8], "little")
    header, tensors = json.loads(data[8:end]), load(data)
    facts = header["__metadata__"]
    way = draw(st.sampled_from(WAYS))
    if way == "length":
        return draw(st.sampled_from([*LENGTHS, end])).to_bytes(8, "little") + data[8:]
    if way == "header":
        return with_header(data, odd.changed_tree(draw, header))
    if way == "bytes":
        return odd.changed_bytes(draw, data[: end + 200]) + data[end + 200 :]
    with np.errstate(all="ignore"):
        if way == "tensors":
            for _ in range(draw(st.integers(1, 2))):
                tensors = changed_tensors(draw, tensors)
    if way == "rows":
        tensors = first_rows(tensors, draw(st.integers(0, 2)))
    if way == "facts":
        facts["metadata"] = json.dumps(odd.changed_tree(draw, json.loads(facts["metadata"])))
    if way == "fact":
        key = draw(st.sampled_from(list(facts)))
        facts |= {key: draw(BAD_FACTS | st.none())}
        facts = {key: text for key, text in facts.items() if text is not None}
    if not odd.rarely(draw, 4):  # it would hide what else is wrong, and older files have none
        facts.pop("checksum", None)
    arrays = {name: np.ascontiguousarray(value) for name, value in tensors.items()}
    return save(arrays, metadata=facts)


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """A command that reads a field."""
    data = good_fields()[draw(st.sampled_from(["plain", "compact", "levels"]))]
    if draw(st.sampled_from([False] + [True] * 9)):
        data = changed_field(draw, data)
    words = tuple(draw(st.sampled_from(COMMANDS)).split())
    files = {"scene.xml": SCENE.encode(), "field.safetensors": data}
    return Case(words, ("pictures/*", "out.*"), ("field.safetensors", "lights: "), files)
