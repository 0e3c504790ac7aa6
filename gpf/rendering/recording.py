"""Recorded frames: kernels are recorded once and launched again without running Python.

Tracing an integrator that is written in Python takes a few milliseconds per frame, more than a
third of the time for a small image.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.camera.recorded_steps import RecordedSteps, nothing_collected
from gpf.scene.inventory import divides_walks
from gpf.scene.materials import require_separable
from gpf.scene.shapes import all_shapes


class RecordedFrames:
    """Recorded frames of one scene and camera.

    The values of arrays may change from frame to frame: those of the scene, of the camera (which
    may move), and those given to the function that is recorded. With other objects or other plain
    values, frames are recorded anew.
    """

    def __init__(self) -> None:
        self._objects: tuple[mi.Scene, mi.Sensor] | None = None
        self._facts: Hashable = None
        self.frozen: Any = None

    def render(
        self,
        function: Callable[..., mi.TensorXf],
        scene: mi.Scene,
        sensor: mi.Sensor,
        seed: Any,
        spp: int,
        arrays: Any,
        facts: Hashable,
    ) -> mi.TensorXf:
        """Render one frame by ``function(scene, sensor, seed, spp, arrays)``; the first two calls
        record.

        Parameters
        ----------
        facts: plain values on which the function depends.
        """
        facts = facts, spp, tuple(int(v) for v in sensor.film().crop_size())
        known = self._objects
        first = known is None or known[0] is not scene or known[1] is not sensor
        if first or self._facts != facts:
            first = True
            self._objects, self._facts = (scene, sensor), facts
            self.frozen = dr.freeze(function)
        try:
            with nothing_collected(first):
                frame: mi.TensorXf = self.frozen(scene, sensor, mi.UInt32(seed), spp, arrays)
                return frame
        except RuntimeError as error:
            raise RuntimeError(
                "This scene cannot be recorded: one of its plugins, such as an orthographic "
                'camera, does not expose all its data to Dr.Jit. Set "record" to false.'
            ) from error


class Vertices:
    """The arrays of a scene's meshes. Recorded functions go on reading the old ones when a mesh
    changes (Dr.Jit 1.5), so they have to be recorded anew."""

    def __init__(self, scene: mi.Scene) -> None:
        meshes = [shape for shape in all_shapes(scene) if isinstance(shape, mi.Mesh)]
        self._buffers: list[Callable[[], mi.Float]] = []
        for mesh in meshes:
            own = mesh.vertex_positions_buffer, mesh.vertex_normals_buffer
            self._buffers += [*own, mesh.vertex_texcoords_buffer]
            known = {"faces", "vertex_positions", "vertex_normals", "vertex_texcoords"}
            names = [name for name, _ in mi.traverse(mesh).items()]
            more = {name for name in names if name.startswith(("vertex_", "face_"))}
            self._buffers += [partial(mesh.attribute_buffer, name) for name in sorted(more - known)]

        self._arrays: list[mi.Float] = []
        self._changes = 0

    def changes(self) -> int:
        """How many calls, including this one, found that a mesh had changed."""
        arrays = [buffer() for buffer in self._buffers]
        # The arrays are held, because Dr.Jit reuses the index of an array that is gone.
        if [a.index for a in arrays] != [a.index for a in self._arrays]:
            self._arrays = arrays
            self._changes += 1
        return self._changes


class KnownScene:
    """What all images of a scene need to know, found out once per scene.

    Attributes
    ----------
    steps: recorded steps of walks in the scene.
    changes: how often :meth:`prepare` found other vertices.
    """

    def __init__(self) -> None:
        # Held so that their ids are not reused. Not the scene: it may hold the integrator, and
        # circular references are never freed.
        self._shapes: list[mi.Shape] | None = None
        self._divides = False
        self._vertices: Vertices | None = None
        self.steps, self.changes = RecordedSteps(), 0

    def prepare(self, scene: mi.Scene) -> None:
        """Before an image: discard what was recorded for another scene or other vertices."""
        self._learn(scene)
        assert self._vertices is not None
        if (changes := self._vertices.changes()) != self.changes:
            self.steps, self.changes = RecordedSteps(), changes

    def divides(self, scene: mi.Scene) -> bool:
        """Whether walks may take both ways at their first surface."""
        self._learn(scene)
        return self._divides

    def _learn(self, scene: mi.Scene) -> None:
        if self._shapes != scene.shapes():
            require_separable(scene)
            self._divides, self._vertices = divides_walks(scene), Vertices(scene)
            self.steps, self._shapes = RecordedSteps(), scene.shapes()
