"""RenderFormer (Zeng and others 2025): a network trained to render triangle scenes.

The scene is written to the files that the published code reads
(:mod:`baselines.renderformer.files`). The published code renders them in a subprocess, and its
image is scaled back to radiance. Nothing is fitted to the scene, so nothing is kept for it.

The network's input is triangles with a diffuse colour, a white specular colour, a roughness and a
white emission. Scenes with glass, water, textures, distant lights or too many triangles are
refused: the network cannot represent them, and the image would show another scene.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from baselines.official import OfficialCode, Program
from baselines.optional import import_optional
from baselines.options import RenderFormerOptions
from baselines.protocol import CannotServe, Task
from baselines.renderformer.files import (
    EDGE,
    Lighting,
    Placement,
    find_placement,
    set_camera,
    split_lights,
    write_scene,
)
from baselines.renderformer.triangle_budget import fit_budget, subdivide
from baselines.renderformer.triangle_scene import join_triangles, read_surfaces
from gpf.core.errors import without_folders
from gpf.scene.pinhole import make_pinhole
from gpf.scene.views import View

CODE = OfficialCode(
    name="renderformer",
    source="https://github.com/microsoft/renderformer",
    variable="GPF_RENDERFORMER",
    file="renderformer/pipelines/rendering_pipeline.py",
)

# Side of the network's images, pixels: a multiple of 8 patches of 8 pixels, and at least the size
# of its training images.
MULTIPLE, SMALLEST = 64, 256


class Renderformer:
    """RenderFormer with its options."""

    def __init__(self, options: RenderFormerOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedRenderformer:
        """Write the scene's files and load the network.

        Raises
        ------
        CannotServe: the network cannot represent the scene, or a package or weights are missing.
        """
        # The scene is checked first: if it is refused, installing a package would not help.
        surfaces = fit_budget(
            read_surfaces(task.scene, str(task.file)), self.options.triangles, str(task.file)
        )
        whole = join_triangles(surfaces)
        placement = find_placement(whole)
        triangles = subdivide(placement.place(whole), EDGE, self.options.triangles)
        lightings = split_lights(triangles, str(task.file))
        import_optional("h5py", "h5py")
        state = task.state.absolute()  # the program's working directory differs
        settings = {"weights": self.options.weights}
        program = Program(CODE, "render_with_renderformer.py", settings, state)
        scenes = []
        for k, lighting in enumerate(lightings):
            scenes.append((state / f"scene_{k}.h5", lighting))
            write_scene(scenes[k][0], triangles, lighting)
            task.report(k + 1, len(lightings))
        facts: dict[str, float | str] = {"triangles": len(triangles)}
        facts["weights"] = without_folders(self.options.weights)
        return PreparedRenderformer(program, scenes, placement, task.size, facts)


class PreparedRenderformer:
    """A loaded network, and the files of the scene."""

    def __init__(
        self,
        program: Program,
        scenes: list[tuple[Path, Lighting]],
        placement: Placement,
        size: tuple[int, int],
        facts: Mapping[str, float | str],
    ) -> None:
        self.program, self.scenes, self.placement, self.size = program, scenes, placement, size
        self._facts: dict[str, Any] = {**facts, **program.started, "network_seconds": 0.0}

    @property
    def storage_bytes(self) -> int:
        """0: the network is the same for all scenes."""
        return 0

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``triangles``, ``weights``, ``device``, ``parameters``, the network's time and memory."""
        return self._facts

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, (H, W, 3) float32; deterministic.

        Raises
        ------
        CannotServe: the network fails, or its image has NaN or infinite values.
        """
        width, height = self.size
        finer = supersampling(self.size)
        side = -(-finer * max(self.size) // MULTIPLE) * MULTIPLE
        camera = make_pinhole(view, self.size)
        # A pixel of the view is a whole number of network pixels wide; the rest is cropped.
        fov = 2 * math.degrees(math.atan(side / (2 * finer * camera.focal)))
        total = np.zeros((height, width, 3))
        for path, lighting in self.scenes:
            set_camera(path, self.placement.place_camera(camera), fov)
            image = self._ask(path, side)
            if not np.isfinite(image).all():
                raise CannotServe(
                    CODE.name, "returned NaN or infinite values", "Report this to its authors."
                )
            cut = crop(image, (finer * width, finer * height))
            blocks = cut.reshape(height, finer, width, finer, 3)
            # The decoder's logarithmic output can be slightly below zero.
            total += np.maximum(blocks.mean(axis=(1, 3)), 0) * lighting.colour
        return total.astype(np.float32)

    def _ask(self, scene: Path, side: int) -> np.ndarray:
        """The network's image of a scene file, (side, side, 3)."""
        file = scene.with_suffix(".npy")
        answer = self.program.ask({"file": str(scene), "resolution": side, "image": str(file)})
        self._facts["network_seconds"] += answer["seconds"]
        self._facts["network_megabytes"] = answer["peak_megabytes"]
        image = np.asarray(np.load(file), dtype=float)
        if image.shape != (side, side, 3):
            raise CannotServe(
                CODE.name,
                f"returned an image of shape {image.shape} instead of {(side, side, 3)}",
                f"Use the current version of {CODE.source}.",
            )
        return image


def supersampling(size: tuple[int, int]) -> int:
    """The number of the network's pixels along the side of one pixel of the view.

    The network's image is then at least SMALLEST. If a side of the view's image is odd, the number
    is even, because the middle of the network's image is between two pixels.
    """
    finer = -(-SMALLEST // max(size))
    return finer + finer % 2 if size[0] % 2 or size[1] % 2 else finer


def crop(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The middle part of an image; its width and height are even, like the image's."""
    left, top = ((image.shape[1 - k] - size[k]) // 2 for k in range(2))
    return image[top : top + size[1], left : left + size[0]]
