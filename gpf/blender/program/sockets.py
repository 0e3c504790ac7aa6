"""Where the inputs of nodes get their values from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Socket:
    """An output of a node, and the group nodes around it, the outermost first."""

    socket: Any
    groups: tuple[Any, ...] = ()

    @property
    def node(self) -> Any:
        """The node that has it."""
        return self.socket.node


@dataclass(frozen=True)
class Input:
    """An input of a node, and the group nodes around it."""

    socket: Any
    groups: tuple[Any, ...] = ()

    def origin(self) -> Socket | None:
        """The output that it gets its value from: through reroutes, groups and muted nodes."""
        if not self.socket.is_linked:
            return None
        link = self.socket.links[0]
        return None if link.is_muted else _origin(Socket(link.from_socket, self.groups))


def _origin(found: Socket) -> Socket | None:
    node, groups = found.node, found.groups
    if node.type == "REROUTE":
        return Input(node.inputs[0], groups).origin()
    if node.type == "GROUP" and node.node_tree is not None:
        ends = [n for n in node.node_tree.nodes if n.type == "GROUP_OUTPUT"]
        end = next((n for n in ends if n.is_active_output), None)
        if end is None:
            return None
        same = next(s for s in end.inputs if s.identifier == found.socket.identifier)
        return Input(same, (*groups, node)).origin() or Socket(same, (*groups, node))
    if node.type == "GROUP_INPUT":
        outside = groups[-1]
        same = next(s for s in outside.inputs if s.identifier == found.socket.identifier)
        return Input(same, groups[:-1]).origin() or Socket(same, groups[:-1])
    if node.mute:
        for inside in node.internal_links:
            if inside.to_socket == found.socket:
                start = Input(inside.from_socket, groups)
                return start.origin() or Socket(inside.from_socket, groups)
        return None
    return found


def plain(socket: Any) -> Any:
    """The value that an input has by itself."""
    value = getattr(socket, "default_value", None)
    if value is None:
        return 0.0
    return [float(v) for v in value][:3] if hasattr(value, "__len__") else float(value)


# Nodes whose outputs are the same everywhere if their inputs are.
CALCULATIONS = {
    *("MATH", "VECT_MATH", "MIX", "MIX_RGB", "CLAMP", "MAP_RANGE", "RGB", "VALUE", "INVERT"),
    *("GAMMA", "HUE_SAT", "BRIGHTCONTRAST", "VALTORGB", "CURVE_RGB", "CURVE_FLOAT", "CURVE_VEC"),
    *("SEPARATE_COLOR", "COMBINE_COLOR", "SEPRGB", "COMBRGB", "SEPXYZ", "COMBXYZ", "RGBTOBW"),
    *("BLACKBODY", "WAVELENGTH", "LIGHT_PATH"),
}


def is_constant(found: Socket) -> bool:
    """Whether an output is certain to have the same value everywhere on a surface."""
    if found.socket in list(found.node.inputs):  # an input of a group that is not linked
        return True
    if found.node.type not in CALCULATIONS:
        return False
    origins = [Input(socket, found.groups).origin() for socket in found.node.inputs]
    return all(origin is None or is_constant(origin) for origin in origins)
