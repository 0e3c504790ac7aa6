"""AnySplat (Jiang and others 2025): Gaussian splats from a few pictures, in one go of a network.

The network gets the training views as pictures of 448×448 pixels, 8-bit sRGB as they would be
shown, and no cameras. It answers with Gaussians and with cameras of its own, in a frame of its own.
The similarity that lays its cameras over the true ones (:mod:`gpf.baselines.anysplat.sim3`) takes every
further view into that frame, where it is splatted; so the Gaussians stay as they are.

The network also guesses how wide the pictures are. Where it is wrong, its scene is deeper or
flatter than the true one, and fits its pictures only at the width that it guessed: the focal length
of a view is the true one times the median of what it guessed over what is true.

The image is turned back from sRGB to radiance; what is brighter than white is white. Left out: the
fourth degree of the colours' harmonics, which the network scales by 0.0004.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from PIL import Image

from gpf.baselines.anysplat.predicted_splats import Prediction, draw, make_splats, read_prediction
from gpf.baselines.anysplat.sim3 import Similarity, align_cameras
from gpf.baselines.official import OfficialCode, Program
from gpf.baselines.options import AnySplatOptions
from gpf.baselines.pinhole import Pinhole, make_pinhole
from gpf.baselines.protocol import CannotServe, Task, TrainingView
from gpf.core.images import tone_map, undo_tone_map
from gpf.scene.views import View

CODE = OfficialCode(
    name="anysplat",
    source="https://github.com/InternRobotics/AnySplat",
    variable="GPF_ANYSPLAT",
    file="src/model/model/anysplat.py",
)

SIDE = 448
"""Pixels of the network's square pictures."""


class Anysplat:
    """AnySplat with its options from params.yaml."""

    def __init__(self, options: AnySplatOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedAnysplat:
        """Let the network see the pictures, unless an earlier call did.

        Raises
        ------
        CannotServe: a package or weights are missing, or what comes back cannot be used.
        """
        state = task.state.absolute()  # the program works elsewhere
        file = state / "splats.npz"
        if not file.exists():
            pictures = state / "pictures.npy"
            np.save(pictures, np.stack([make_picture(v, task.exposure) for v in task.training]))
            settings = {"weights": self.options.weights}
            program = Program(CODE, "infer_with_anysplat.py", settings, state)
            program.ask({"images": str(pictures), "splats": str(file)})
            program.close()  # the network is not needed any more, and large
        task.report(1, 1)
        found = read_prediction(file, len(task.training))
        cameras = [make_pinhole(shot.view, picture_size(shot)) for shot in task.training]
        try:
            to_world = align_cameras(found.poses, np.stack([camera.pose for camera in cameras]))
        except ValueError as error:
            raise CannotServe(
                CODE.name,
                f"its cameras cannot be laid over the true ones: {error}",
                "Give it other training views, or leave it out for this scene.",
            ) from error
        return PreparedAnysplat(task, found, cameras, to_world)


class PreparedAnysplat:
    """Gaussians in the network's frame, and how to get there."""

    def __init__(
        self, task: Task, found: Prediction, cameras: list[Pinhole], to_world: Similarity
    ) -> None:
        self.size, self.exposure = task.size, task.exposure
        self.splats, self.background = make_splats(found), found.background
        self.from_world = to_world.inverse()
        self.focal_ratio = compare_focals(found, cameras)
        self._facts: dict[str, float | str] = {
            "gaussians": len(found.means),
            "camera_error": place_error(found, cameras, to_world),
            "focal_ratio": self.focal_ratio,
            "network_seconds": found.seconds,
            "device": found.device,
        }

    @property
    def storage_bytes(self) -> int:
        """The Gaussians, as they are drawn, in float32."""
        return sum(4 * len(array) for array in self.splats.arrays())

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``gaussians``; ``camera_error``, see :func:`place_error`; ``focal_ratio``."""
        return self._facts

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, (H, W, 3) float32. Nothing is random in it."""
        camera = self.from_world.apply_camera(make_pinhole(view, self.size))
        camera = replace(camera, focal=camera.focal * self.focal_ratio)
        shown = draw(self.splats, camera, self.background)
        return (undo_tone_map(shown) / self.exposure).astype(np.float32)


def make_picture(shot: TrainingView, exposure: float) -> np.ndarray:
    """What the network sees of a view: the middle square, (448, 448, 3) uint8.

    Scaled and cut as the authors do it.
    """
    shown = np.round(tone_map(shot.radiance, exposure) * 255).astype(np.uint8)
    height, width = shown.shape[:2]
    factor = SIDE / min(width, height)
    size = max(SIDE, int(width * factor)), max(SIDE, int(height * factor))
    picture = Image.fromarray(shown).resize(size)
    left, top = (size[0] - SIDE) // 2, (size[1] - SIDE) // 2
    return np.asarray(picture.crop((left, top, left + SIDE, top + SIDE)))


def picture_size(shot: TrainingView) -> tuple[int, int]:
    """Width and height of a view's image."""
    return shot.radiance.shape[1], shot.radiance.shape[0]


def compare_focals(found: Prediction, cameras: list[Pinhole]) -> float:
    """The median of the network's focal lengths over the true ones."""
    true = np.array([camera.focal / min(camera.size) for camera in cameras])
    return float(np.median(found.intrinsics[:, [0, 1], [0, 1]] / true[:, None]))


def place_error(found: Prediction, cameras: list[Pinhole], to_world: Similarity) -> float:
    """How far the network's cameras end from the true ones, over their spread; root mean squares.

    0 is perfect; with cameras at random places it is about 1.
    """
    true = np.stack([camera.origin for camera in cameras])
    apart = ((to_world.apply(found.poses[:, :3, 3]) - true) ** 2).sum()
    return float(np.sqrt(apart / ((true - true.mean(axis=0)) ** 2).sum()))
