"""Node trees that Cycles turns into images, one object after another."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from geometry import column
from nodes import Closure, values, with_plain_inputs
from sockets import Socket, is_constant
from sources import socket_of

UV = "gpf_bake"
SAMPLES = 4

FLAT_SIZE = 32
"""Width of images that have the same value everywhere."""


@dataclass
class Baking:
    """Bakes the materials of meshes.

    Attributes
    ----------
    folder: where arrays are written.
    extent: length of the scene's diagonal, for the size of images.
    tell: is told what is being baked.
    times: how many times each mesh was baked.
    """

    folder: Path
    extent: float
    tell: Callable[[str], None]
    times: Counter[str] = field(default_factory=Counter)
    _known: dict[str, tuple[str, dict[int, Closure], np.ndarray]] = field(default_factory=dict)
    _count: int = field(default=0)

    def find(
        self, key: str, origin: str, closures: dict[int, Closure]
    ) -> tuple[dict[int, Closure], np.ndarray] | None:
        """The closures of a mesh that were baked, with the inputs that are plain now, and the UVs
        of their images, (L, 2); None unless it has the same ``origin`` as then."""
        known, baked, uv = self._known.get(key, ("", {}, np.empty(0)))
        if known != origin:
            return None
        return {k: with_plain_inputs(baked[k], now) for k, now in closures.items()}, uv

    def bake(
        self, key: str, origin: str, closures: dict[int, Closure], thing: Any, mesh: Any
    ) -> None:
        """Bake everything in a mesh's closures that is no plain value.

        Inputs that are images become part of the new ones, which have UVs of their own.

        Parameters
        ----------
        key: a name for the mesh, the same in all frames.
        origin: what the result depends on, as a text to compare.
        closures: what the slots have that it uses.
        thing: its object.
        mesh: a copy; it is removed.
        """
        self.tell(f"baking {thing.name}")
        with _stand_in(thing, mesh) as other:
            self._bake(other, closures)
            self._known[key] = origin, closures, column(mesh.uv_layers[UV].uv, "vector", 2)
        bpy.data.meshes.remove(mesh)
        self.times[key] += 1

    def _bake(self, thing: Any, closures: dict[int, Closure]) -> None:
        """Replace everything to bake in an object's closures with arrays."""
        _unwrap(thing)
        size = self._size(thing)
        wanted = {slot: values(closure) for slot, closure in closures.items()}
        emitted = {
            slot: [(owner, key) for owner, key in found if key != "normal"]
            for slot, found in wanted.items()
        }
        bent = [
            (owner, key) for found in wanted.values() for owner, key in found if key == "normal"
        ]
        displaced = [closure for closure in closures.values() if closure.pop("displaced", False)]
        if bent or displaced:
            pixels = self._pass(thing, size, "NORMAL", {})
            file = self._write(pixels)
            for owner, key in bent:
                owner[key] = {"array": file, "channel": None, "strength": 1.0}
            for closure in displaced:
                closure["normal"] = {"array": file, "channel": None, "strength": 1.0}
        for number in range(max(map(len, emitted.values()), default=0)):
            now = {slot: found[number] for slot, found in emitted.items() if number < len(found)}
            sockets = {slot: socket_of(owner[key]) for slot, (owner, key) in now.items()}
            flat = all(is_constant(socket) for socket in sockets.values())
            pixels = self._pass(thing, FLAT_SIZE if flat else size, "EMIT", sockets)
            for owner, key in now.values():
                owner[key] = {"array": self._write(pixels), "channel": None}

    def _size(self, thing: Any) -> int:
        corners = np.array([thing.matrix_world @ v.co for v in thing.data.vertices[:100_000]])
        own = np.linalg.norm(np.ptp(corners, axis=0)) if len(corners) else 0.0
        share = own / max(self.extent, 1e-30)
        return int(2 ** np.clip(np.round(np.log2(max(4096 * share, 1))), 8, 11))

    def _pass(self, thing: Any, size: int, kind: str, sockets: dict[int, Socket]) -> np.ndarray:
        """Bake once: pixels, (size, size, 3), from the bottom."""
        image = bpy.data.images.new("gpf bake", size, size, float_buffer=True)
        image.colorspace_settings.name = "Non-Color"
        undo = []
        try:
            for slot in range(len(thing.material_slots)):
                material = thing.material_slots[slot].material
                if material is None or material.node_tree is None:
                    continue
                target = material.node_tree.nodes.new("ShaderNodeTexImage")
                target.image = image
                material.node_tree.nodes.active = target
                undo.append((material.node_tree, target))
            wired = [_emit(thing.material_slots[slot].material, s) for slot, s in sockets.items()]
            scene = bpy.context.scene
            scene.render.engine = "CYCLES"
            scene.cycles.samples, scene.cycles.use_denoising = SAMPLES, False
            scene.render.bake.use_selected_to_active = False
            bpy.ops.object.bake(type=kind, margin=8, use_clear=True, normal_space="TANGENT")
            for restore in wired:
                restore()
            pixels = np.empty(size * size * 4, np.float32)
            image.pixels.foreach_get(pixels)
        finally:
            for tree, node in undo:
                tree.nodes.remove(node)
            bpy.data.images.remove(image)
        return pixels.reshape(size, size, 4)[..., :3]

    def _write(self, pixels: np.ndarray) -> str:
        self._count += 1
        name = f"baked_{self._count}.npy"
        np.save(self.folder / name, pixels)
        return name


@contextmanager
def _stand_in(thing: Any, mesh: Any) -> Iterator[Any]:
    """An object with a mesh, seen and selected, in place of the one that Blender renders so: that
    may be hidden in the viewport, have modifiers, or be no mesh."""
    name, hidden = thing.name, thing.hide_render
    thing.name, thing.hide_render = "gpf bake", True
    other = bpy.data.objects.new(name, mesh)  # nodes draw random numbers from the name
    other.matrix_world, other.color = thing.matrix_world, thing.color
    other.pass_index = thing.pass_index
    for key, value in thing.items():
        if not hasattr(value, "keys"):
            other[key] = value
    bpy.context.scene.collection.objects.link(other)
    for each in bpy.context.view_layer.objects:
        each.select_set(each == other)
    try:
        yield other
    finally:
        bpy.data.objects.remove(other)
        thing.name, thing.hide_render = name, hidden


def _unwrap(thing: Any) -> None:
    """Give the mesh of an object UVs without overlaps."""
    bpy.context.view_layer.objects.active = thing
    thing.data.uv_layers.active = thing.data.uv_layers.new(name=UV)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    # Else the shape of an image that the material has would stretch them.
    bpy.ops.uv.smart_project(island_margin=0.003, correct_aspect=False)
    bpy.ops.object.mode_set(mode="OBJECT")


def _emit(material: Any, found: Socket) -> Callable[[], None]:
    """Make a material emit the value of an output; the function that is returned undoes it."""
    source = found.socket
    for number in range(len(found.groups), 0, -1):  # out of each group, the innermost first
        group = found.groups[number - 1]
        source = _lead_out(group, source)
    tree = material.node_tree
    output = tree.get_output_node("CYCLES")
    surface = output.inputs["Surface"]
    before = surface.links[0].from_socket if surface.is_linked else None
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(source, emission.inputs["Color"])
    tree.links.new(emission.outputs[0], surface)

    def restore() -> None:
        tree.nodes.remove(emission)
        if before is not None:
            tree.links.new(before, surface)

    return restore


def _lead_out(group: Any, source: Any) -> Any:
    """A new output of a group node, with the value of an output in the group."""
    tree = group.node_tree
    new = tree.interface.new_socket("gpf", in_out="OUTPUT", socket_type="NodeSocketColor")
    end = next(n for n in tree.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output)
    tree.links.new(source, next(s for s in end.inputs if s.identifier == new.identifier))
    return next(s for s in group.outputs if s.identifier == new.identifier)
