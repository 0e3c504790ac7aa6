"""What is behind the inputs of a closure; where it is as before, old images of it serve."""

from __future__ import annotations

from typing import Any

import bpy
from nodes import Closure, plain_inputs
from sockets import Input, Socket


def sources(closure: Closure) -> str:
    """The values of all nodes that the inputs of a closure come from, and its displacement, as a
    text to compare. Plain inputs are not among them."""
    seen: set[Any] = set()
    found = [socket_of(value) for value in plain_inputs(closure)]
    found += [closure["displaced"]] if "displaced" in closure else []
    return repr([_behind(socket, seen) for socket in found])


def socket_of(value: dict[str, Any]) -> Socket:
    """The output that an input of a closure gets its value from."""
    if "otherwise" in value:
        value = value["otherwise"]
    socket: Socket = value["bake"] if "bake" in value else value["origin"]
    return socket


def _behind(found: Socket, seen: set[Any]) -> Any:
    node, groups = found.node, found.groups
    if found.socket in list(node.inputs):  # an input of a group, or of a muted node
        return _value(found.socket)
    place = node, groups
    if place in seen:
        return node.name
    seen.add(place)
    state = [node.name, found.socket.identifier, _own(node)]
    for socket in node.inputs:
        origin = Input(socket, groups).origin()
        state.append(_value(socket) if origin is None else _behind(origin, seen))
    return state


def _own(node: Any) -> list[Any]:
    """What a node has beside its inputs."""
    names = {*node.bl_rna.properties.keys()} - {*bpy.types.Node.bl_rna.properties.keys()}
    kinds = {name: node.bl_rna.properties[name].type for name in sorted(names)}
    plain = [name for name, kind in kinds.items() if kind in ("BOOLEAN", "ENUM", "FLOAT", "INT")]
    found = [_plain(getattr(node, name)) for name in plain]
    found += [_value(socket) for socket in node.outputs]  # Value and RGB
    if ramp := getattr(node, "color_ramp", None):
        found += [(element.position, *element.color) for element in ramp.elements]
    if (image := getattr(node, "image", None)) and image.source in ("SEQUENCE", "MOVIE"):
        found.append(bpy.context.scene.frame_current)
    if thing := getattr(node, "object", None):
        found.append(_plain(thing.matrix_world))
    return found


def _value(socket: Any) -> Any:
    return _plain(getattr(socket, "default_value", None))


def _plain(value: Any) -> Any:
    return (
        [_plain(v) for v in value] if hasattr(value, "__len__") and value != str(value) else value
    )
