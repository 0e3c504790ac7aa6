"""A data set with depth and normals, and a check that its parts fit together.

    python examples/data_set.py OUT --seconds 30

`gpf render` writes pictures, depth, normals and transforms.json, as nerfstudio reads them. Here
numpy reads them: the depth of one view gives points in space, and another view lends these points
its colours. OUT receives the data set and a picture: on the left the borrowed colours (blue where
the other view does not see the point), on the right the picture from the data set.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import typer
from PIL import Image
from scipy.ndimage import map_coordinates

import gpf
from gpf.core.progress import say

SCENE = Path(__file__).parents[1] / "scenes" / "cornell_box" / "scene.xml"


class Frame:
    """A view of the data set. The camera looks along its -z, and y is up."""

    def __init__(self, folder: Path, number: int) -> None:
        content = json.loads((folder / "transforms.json").read_text())
        frame = content | content["frames"][number]
        self.pose = np.array(frame["transform_matrix"])  # camera to world
        self.focal, self.centre = frame["fl_x"], np.array([frame["cx"], frame["cy"]])
        self.picture = np.array(Image.open(folder / frame["file_path"])) / 255
        self.depth = np.load(folder / frame["depth_file_path"]) / 1000
        self.normal = np.array(Image.open(folder / frame["normal_file_path"])) / 127.5 - 1

    def points(self) -> np.ndarray:
        """The surface in the middle of each pixel, world units, (H, W, 3)."""
        row, column = np.indices(self.depth.shape) + 0.5
        x, y = (column - self.centre[0]) / self.focal, (row - self.centre[1]) / self.focal
        ray = np.dstack([x, -y, -np.ones_like(x)])
        return ray * self.depth[..., None] @ self.pose[:3, :3].T + self.pose[:3, 3]

    def look_up(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Colours and normals where points appear in this view, and whether it sees them."""
        x, y, z = np.moveaxis((points - self.pose[:3, 3]) @ self.pose[:3, :3], 2, 0)
        z = np.minimum(z, -1e-9)  # only points in front of the camera are seen
        row = self.centre[1] + self.focal * y / z - 0.5
        column = self.centre[0] - self.focal * x / z - 0.5
        layers = np.dstack([self.picture, self.normal, self.depth])
        found = [
            map_coordinates(layer, [row, column], order=1) for layer in layers.transpose(2, 0, 1)
        ]
        colour, normal, depth = np.dstack(found[:3]), np.dstack(found[3:6]), found[6]
        back = self.pose[:3, 3] - points
        faces = (back * normal).sum(axis=2) > 0  # from behind, walls are black
        return colour, normal, faces & (np.abs(depth + z) < 0.01 * depth)


def main(folder: Path, seconds: float = 30, size: int = 256) -> None:
    """Write the folder data_set and data_set.png into FOLDER."""
    folder.mkdir(parents=True, exist_ok=True)
    gpf.choose_variant("auto")
    file, data_set = folder / "field.safetensors", folder / "data_set"
    say(f"Fitting for {seconds:g} seconds.")
    gpf.save_field(gpf.fit(gpf.load_scene_file(SCENE), seconds=seconds), file)
    options = ["--orbit", "8", "--size", f"{size}x{size}", "--aovs", "depth,normal"]
    command = ["gpf.cli", "render", SCENE, "--field", file, "-o", data_set, *options]
    subprocess.run([sys.executable, "-m", *command], check=True)

    frame, other = Frame(data_set, 0), Frame(data_set, 1)
    colour, normal, seen = other.look_up(frame.points())
    error = np.abs(colour - frame.picture)[seen].mean()
    angle = np.degrees(np.arccos(np.clip((normal * frame.normal).sum(axis=2)[seen], -1, 1)))
    say(f"{100 * seen.mean():.0f}% of the points are seen by both views. There, colours differ by")
    say(f"{100 * error:.1f}% of white and normals by {np.median(angle):.1f} degrees.")
    warped = np.where(frame.depth[..., None] > 0, [0.1, 0.2, 0.6], frame.picture)
    warped[seen] = colour[seen]
    pair = np.concatenate([warped, frame.picture], axis=1)
    Image.fromarray(np.uint8(255 * pair + 0.5)).save(folder / "data_set.png")


if __name__ == "__main__":
    typer.run(main)
