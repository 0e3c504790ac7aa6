"""RenderFormer (Zeng and others 2025): a network that was taught what lit triangles look like.

The scene becomes the file that the published code reads (:mod:`gpf.baselines.renderformer.files`),
the published code renders it in a process of its own, and its image is scaled back to radiance.
Nothing is fitted to the scene, so nothing has to be kept for it.

A token of the network is a triangle with a diffuse colour, a white specular one, a roughness and a
white glow. Glass, water, textures, distant lights and more triangles than fit are refused: the
network has no place for them, and an image of another scene would only look like a result.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gpf.baselines.official import OfficialCode, Program
from gpf.baselines.optional import import_optional
from gpf.baselines.options import RenderFormerOptions
from gpf.baselines.pinhole import make_pinhole
from gpf.baselines.protocol import CannotServe, Task
from gpf.baselines.renderformer.files import (
    EDGE,
    Lighting,
    Placement,
    find_placement,
    set_camera,
    split_lights,
    write_scene,
)
from gpf.baselines.renderformer.triangle_budget import fit_budget, subdivide
from gpf.baselines.renderformer.triangle_scene import join_triangles, read_surfaces
from gpf.scene.views import View

CODE = OfficialCode(
    name="renderformer",
    source="https://github.com/microsoft/renderformer",
    variable="GPF_RENDERFORMER",
    file="renderformer/pipelines/rendering_pipeline.py",
)

# Sides of its images: multiples of 8 patches of 8 pixels, and no smaller than it was trained with.
MULTIPLE, SMALLEST = 64, 256


class Renderformer:
    """RenderFormer with its options from params.yaml."""

    def __init__(self, options: RenderFormerOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedRenderformer:
        """Write the scene's files and load the network.

        Raises
        ------
        CannotServe: the scene is beyond it, or a package or the weights are missing.
        """
        # What the scene rules out comes first: no package would mend that.
        surfaces = fit_budget(
            read_surfaces(task.scene, str(task.file)), self.options.triangles, str(task.file)
        )
        whole = join_triangles(surfaces)
        placement = find_placement(whole)
        triangles = subdivide(placement.place(whole), EDGE, self.options.triangles)
        lightings = split_lights(triangles, str(task.file))
        import_optional("h5py", "h5py")
        state = task.state.absolute()  # the program works elsewhere
        settings = {"weights": self.options.weights}
        program = Program(CODE, "render_with_renderformer.py", settings, state)
        scenes = []
        for k, lighting in enumerate(lightings):
            scenes.append((state / f"scene_{k}.h5", lighting))
            write_scene(scenes[k][0], triangles, lighting)
            task.report(k + 1, len(lightings))
        facts: dict[str, float | str] = {"triangles": len(triangles)}
        facts["weights"] = self.options.weights
        return PreparedRenderformer(program, scenes, placement, task.size, facts)


class PreparedRenderformer:
    """A loaded network, and the scene in files."""

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
        """Nothing: the network is the same for all scenes."""
        return 0

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``triangles``, ``weights``, ``device``, ``parameters``, and what the network took."""
        return self._facts

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, (H, W, 3) float32. Nothing is random in it.

        Raises
        ------
        CannotServe: the network fails, or gives no numbers.
        """
        width, height = self.size
        finer = supersampling(self.size)
        side = -(-finer * max(self.size) // MULTIPLE) * MULTIPLE
        camera = make_pinhole(view, self.size)
        # Pixels as wide as asked for, or a whole fraction; what is too much is cut off all round.
        fov = 2 * math.degrees(math.atan(side / (2 * finer * camera.focal)))
        total = np.zeros((height, width, 3))
        for path, lighting in self.scenes:
            set_camera(path, self.placement.place_camera(camera), fov)
            image = self._ask(path, side)
            if not np.isfinite(image).all():
                raise CannotServe(
                    CODE.name, "images that are no numbers", "Report it to the authors."
                )
            cut = crop(image, (finer * width, finer * height))
            blocks = cut.reshape(height, finer, width, finer, 3)
            # The decoder's logarithm can end just below zero.
            total += np.maximum(blocks.mean(axis=(1, 3)), 0) * lighting.colour
        return total.astype(np.float32)

    def _ask(self, scene: Path, side: int) -> np.ndarray:
        """The network's own image of a file, (side, side, 3)."""
        file = scene.with_suffix(".npy")
        answer = self.program.ask({"file": str(scene), "resolution": side, "image": str(file)})
        self._facts["network_seconds"] += answer["seconds"]
        self._facts["network_megabytes"] = answer["peak_megabytes"]
        image = np.asarray(np.load(file), dtype=float)
        if image.shape != (side, side, 3):
            raise CannotServe(
                CODE.name,
                f"images of {image.shape}, where {(side, side, 3)} was asked for",
                f"Take the current version of {CODE.source}.",
            )
        return image


def supersampling(size: tuple[int, int]) -> int:
    """How many of the network's pixels go to the side of one of the image's.

    Enough for its smallest image, and an even number where a side of the image is odd: the middle
    of the network's image is between pixels.
    """
    finer = -(-SMALLEST // max(size))
    return finer + finer % 2 if size[0] % 2 or size[1] % 2 else finer


def crop(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The middle of an image, of an even width and height like the image itself."""
    left, top = ((image.shape[1 - k] - size[k]) // 2 for k in range(2))
    return image[top : top + size[1], left : left + size[0]]
