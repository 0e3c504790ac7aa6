"""Node trees that Cycles turns into images, one object after another."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from geometry import Unwrapping, vertices_of_corners
from nodes import Closure, values, with_plain_inputs
from sockets import Socket, is_constant
from sources import socket_of, sources

UV = "gpf_bake"
SAMPLES = 4

AS_RENDERED = {
    "levels": "render_levels",
    "viewport_resolution": "resolution",
    "resolution_u": "render_resolution_u",
    "resolution_v": "render_resolution_v",
    "resolution": "render_resolution",
}
"""Of modifiers and curves: what the viewport shows, and what is rendered."""

FLAT_SIZE = 32
"""Width of images that have the same value everywhere."""


@dataclass(frozen=True)
class _Baked:
    """What an object was baked from, and what came of it."""

    origin: str
    closures: dict[int, Closure]


@dataclass
class Baking:
    """Bakes the materials of objects.

    Attributes
    ----------
    folder: where arrays are written.
    extent: length of the scene's diagonal, for the size of images.
    tell: is told what is being baked.
    unwrapped: for the name of each object that is baked, where its images lie on its mesh.
    times: how many times it was baked.
    """

    folder: Path
    extent: float
    tell: Callable[[str], None]
    unwrapped: dict[str, Unwrapping] = field(default_factory=dict)
    times: Counter[str] = field(default_factory=Counter)
    _known: dict[str, _Baked] = field(default_factory=dict)
    _count: int = field(default=0)

    def bake(self, thing: Any, closures: dict[int, Closure]) -> dict[int, Closure]:
        """An object's closures, by slot, with arrays for everything to bake.

        Inputs that are images become part of the new ones, which have UVs of their own. Images from
        before serve again if the object's faces and the nodes behind them are the same.
        """
        with _in_view(thing), _evaluated(thing) as mesh:
            faces = hashlib.sha256(vertices_of_corners(mesh)).hexdigest()
            origin = faces + "".join(sources(closure) for closure in closures.values())
            known = self._known.get(thing.name)
            if known is None or known.origin != origin:
                self.tell(f"baking {thing.name}")
                with _with_mesh(thing, mesh) as shown:
                    self._bake(shown, closures)
                self.unwrapped[thing.name] = Unwrapping.of(mesh, mesh.uv_layers[UV])
                self.times[thing.name] += 1
                self._known[thing.name] = _Baked(origin, closures)
                return closures
        return {k: with_plain_inputs(known.closures[k], now) for k, now in closures.items()}

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
def _in_view(thing: Any) -> Iterator[None]:
    """Have an object evaluated and selected, as it is rendered."""
    layer, scene = bpy.context.view_layer, bpy.context.scene
    for owner in (*thing.modifiers, thing.data):
        for shown, rendered in AS_RENDERED.items():
            if hasattr(owner, shown) and (value := getattr(owner, rendered, 0)):
                setattr(owner, shown, value)
    for modifier in thing.modifiers:
        modifier.show_viewport = modifier.show_render
    for other in list(layer.objects):
        other.select_set(False)
    linked = thing.name not in layer.objects
    if linked:
        scene.collection.objects.link(thing)
    hidden, thing.hide_viewport, thing.hide_select = thing.hide_viewport, False, False
    thing.hide_set(False)
    try:
        yield
    finally:
        thing.hide_viewport = hidden
        if linked:
            scene.collection.objects.unlink(thing)
        layer.update()


@contextmanager
def _evaluated(thing: Any) -> Iterator[Any]:
    """A mesh of its own with what an object's modifiers make."""
    graph = bpy.context.evaluated_depsgraph_get()
    mesh = bpy.data.meshes.new_from_object(
        thing.evaluated_get(graph), preserve_all_data_layers=True, depsgraph=graph
    )
    if thing.type == "MESH":
        mesh.use_auto_texspace = False
        mesh.texspace_location = thing.data.texspace_location
        mesh.texspace_size = thing.data.texspace_size
    try:
        yield mesh
    finally:
        bpy.data.meshes.remove(mesh)


@contextmanager
def _with_mesh(thing: Any, mesh: Any) -> Iterator[Any]:
    """An object with this mesh and no modifiers: itself or, if it is no mesh, one in its place."""
    if thing.type != "MESH":
        other = bpy.data.objects.new(thing.name, mesh)
        other.matrix_world = thing.matrix_world
        bpy.context.scene.collection.objects.link(other)
        try:
            yield other
        finally:
            bpy.data.objects.remove(other)
        return
    before, shown = thing.data, {m: (m.show_viewport, m.show_render) for m in thing.modifiers}
    for modifier in thing.modifiers:
        modifier.show_viewport = modifier.show_render = False
    thing.data = mesh
    try:
        yield thing
    finally:
        thing.data = before
        for modifier, (viewport, render) in shown.items():
            modifier.show_viewport, modifier.show_render = viewport, render


def _unwrap(thing: Any) -> None:
    """Give the mesh of an object UVs without overlaps."""
    thing.select_set(True)
    bpy.context.view_layer.objects.active = thing
    thing.data.uv_layers.active = thing.data.uv_layers.new(name=UV)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(island_margin=0.003)
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
