"""What a scene consists of, as short digests: has it changed since a field was fitted to it?"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from typing import Any

import mitsuba as mi
import numpy as np

PARTS = ("geometry", "materials", "lights")


def fingerprint(scene: mi.Scene) -> dict[str, str]:
    """A digest of each of the :data:`PARTS` of a scene; cameras and integrators do not matter.

    It covers the values that Mitsuba gives access to, and the printed form of materials and lights.
    """
    digests = {part: hashlib.sha256() for part in PARTS}
    for part, facts in _facts(scene):
        digests[part].update(facts)
    return {part: digest.hexdigest()[:16] for part, digest in digests.items()}


def changed_parts(first: Mapping[str, str], second: Mapping[str, str]) -> list[str]:
    """The parts in which two fingerprints differ."""
    return [part for part in PARTS if first.get(part) != second.get(part)]


def _facts(scene: mi.Scene) -> Iterator[tuple[str, bytes]]:
    """The facts of each part, in the order of the scene's shapes."""
    for shape in scene.shapes():
        bsdf, emitter = shape.bsdf(), shape.emitter()
        children: set[Any] = set()
        for child in (bsdf, emitter):
            children |= set() if child is None else set(mi.traverse(child).hierarchy)
        yield from (("geometry", fact) for fact in _values(shape, children))
        if bsdf is not None:
            yield from (("materials", fact) for fact in _values(bsdf, set()))
            yield "materials", str(bsdf).encode()  # has what is not among the values
        # Which shape is a lamp matters as well as how bright it is.
        yield "lights", b"lamp" if emitter is not None else b"no lamp"
    for emitter in scene.emitters():
        yield from (("lights", fact) for fact in _values(emitter, set()))


def _values(thing: Any, without: set[Any]) -> Iterator[bytes]:
    """The class and the values of an object and of those below it, but for some of them."""
    yield thing.class_name().encode()
    found = mi.traverse(thing)
    for key in sorted(found.properties):
        if found.properties[key][2] not in without:
            value = found[key]
            yield key.rpartition(".")[2].encode()
            yield np.array(getattr(value, "matrix", value)).tobytes()
