"""AnySplat (Jiang and others 2025): Gaussian splats from a few images, in one run of a network.

The network gets the training views as 8-bit sRGB images of 448×448 pixels, without cameras. It
predicts Gaussians and cameras in a frame of its own. A similarity aligns its cameras with the true
ones (:mod:`baselines.anysplat.sim3`). Its inverse takes every further camera into the network's
frame, where the view is rendered; the Gaussians are not changed.

The network also predicts the focal lengths. If these are wrong, its scene is deeper or flatter than
the true one and fits its images only with the predicted focal lengths. So the focal length of a
view is multiplied by the median of predicted over true focal lengths.

The rendered image is converted from sRGB back to radiance, so nothing is brighter than white. Left
out: the fourth degree of the spherical harmonics, which the network scales by 0.0004.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from PIL import Image

from baselines.anysplat.predicted_splats import Prediction, draw, make_splats, read_prediction
from baselines.anysplat.sim3 import Similarity, align_cameras
from baselines.official import OfficialCode, Program
from baselines.options import AnySplatOptions
from baselines.protocol import CannotServe, Task, TrainingView
from gpf.core.images import tone_map, undo_tone_map
from gpf.scene.pinhole import Pinhole, make_pinhole
from gpf.scene.views import View

CODE = OfficialCode(
    name="anysplat",
    source="https://github.com/InternRobotics/AnySplat",
    variable="GPF_ANYSPLAT",
    file="src/model/model/anysplat.py",
)

SIDE = 448
"""Width and height of the network's images, pixels."""


class Anysplat:
    """AnySplat with its options."""

    def __init__(self, options: AnySplatOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedAnysplat:
        """Run the network on the training views, unless an earlier call did.

        Raises
        ------
        CannotServe: a package or weights are missing, or the prediction cannot be used.
        """
        state = task.state.absolute()  # the program's working directory differs
        file = state / "splats.npz"
        if not file.exists():
            pictures = state / "pictures.npy"
            np.save(pictures, np.stack([make_picture(v, task.exposure) for v in task.training]))
            settings = {"weights": self.options.weights}
            program = Program(CODE, "infer_with_anysplat.py", settings, state)
            program.ask({"images": str(pictures), "splats": str(file)})
            program.close()  # the network is large and no longer needed
        task.report(1, 1)
        found = read_prediction(file, len(task.training))
        cameras = [make_pinhole(shot.view, picture_size(shot)) for shot in task.training]
        try:
            to_world = align_cameras(found.poses, np.stack([camera.pose for camera in cameras]))
        except ValueError as error:
            raise CannotServe(
                CODE.name,
                f"its cameras cannot be aligned with the true ones: {error}",
                "Give it other training views, or leave it out for this scene.",
            ) from error
        return PreparedAnysplat(task, found, cameras, to_world)


class PreparedAnysplat:
    """Gaussians in the network's frame, and the similarity from the world to it."""

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
        """The Gaussians as they are rendered, float32."""
        return sum(4 * len(array) for array in self.splats.arrays())

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``gaussians``, ``camera_error`` (:func:`place_error`), ``focal_ratio``, time, device."""
        return self._facts

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, (H, W, 3) float32; deterministic."""
        camera = self.from_world.apply_camera(make_pinhole(view, self.size))
        camera = replace(camera, focal=camera.focal * self.focal_ratio)
        shown = draw(self.splats, camera, self.background)
        return (undo_tone_map(shown) / self.exposure).astype(np.float32)


def make_picture(shot: TrainingView, exposure: float) -> np.ndarray:
    """The network's input for a view: the middle square, (448, 448, 3) uint8.

    Scaled and cropped as in the authors' code.
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
    """The median ratio of the network's focal lengths to the true ones."""
    true = np.array([camera.focal / min(camera.size) for camera in cameras])
    return float(np.median(found.intrinsics[:, [0, 1], [0, 1]] / true[:, None]))


def place_error(found: Prediction, cameras: list[Pinhole], to_world: Similarity) -> float:
    """Root mean square distance of aligned from true cameras, divided by the true ones' spread.

    0 is perfect; cameras at random places give about 1.
    """
    true = np.stack([camera.origin for camera in cameras])
    apart = ((to_world.apply(found.poses[:, :3, 3]) - true) ** 2).sum()
    return float(np.sqrt(apart / ((true - true.mean(axis=0)) ** 2).sum()))
