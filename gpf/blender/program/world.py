"""The world: light from far away."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from around import save_exr, scene_around
from nodes import plain_closure, read_closure, values
from sockets import Input
from sources import sources

WIDTH = 2048
"""Width of the environment map, pixels."""


@dataclass
class World:
    """Reads the world of a scene.

    Attributes
    ----------
    folder: where images are written.
    tell: is told when one is rendered.
    times: how many have been.
    notes: what is left out or approximated.
    """

    folder: Path
    tell: Callable[[str], None]
    times: int = 0
    notes: list[str] = field(default_factory=list)
    _origin: str = ""

    def read(self, scene: Any) -> dict[str, Any] | None:
        """A constant, or an image that Cycles renders of it; None: none.

        The image is a map of all directions (EXR), (WIDTH / 2, WIDTH). Its middle is +x. The one
        from before serves again if the nodes behind it are the same.
        """
        world = scene.world
        self.notes.clear()
        if world is None:
            return None
        if world.node_tree is None or not getattr(world, "use_nodes", True):
            return _constant(world.color)
        output = world.node_tree.get_output_node("CYCLES")
        if output is None:
            return None
        if Input(output.inputs["Volume"]).origin() is not None:
            self.notes.append("the world: its volume left out")
        found = read_closure(Input(output.inputs["Surface"]))
        if found["closure"] == "none":
            return None
        if found["closure"] == "emission" and not values(found):
            return _constant([c * found["strength"] for c in found["color"]])
        origin = f"{world.name} {plain_closure(found)} {sources(found)}"
        if origin != self._origin:
            self.tell("world")
            self.times += 1
            self._origin = origin
            _render(world, self.folder / f"world_{self.times}.exr")
        return {"file": f"world_{self.times}.exr"}


def _constant(radiance: Any) -> dict[str, Any] | None:
    return {"radiance": list(radiance)} if any(radiance) else None


def _render(world: Any, path: Path) -> None:
    """Render all directions by Cycles, from the origin of an empty scene."""
    trees = [world.node_tree, *(n.node_tree for n in world.node_tree.nodes if n.type == "GROUP")]
    has_sky = any(node.type == "TEX_SKY" for tree in trees if tree for node in tree.nodes)
    samples = 32 if has_sky else 4  # the sun of a sky is three pixels wide
    world.cycles_visibility.camera = True
    with scene_around(WIDTH, samples) as scene:
        scene.world = world
        save_exr(scene, path)
