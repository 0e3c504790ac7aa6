"""Compare a scene with the original that it is modelled after: `python docs/compare_scene.py -h`.

Both scenes are rendered with the original's camera and integrator (and its depth) and the same
film. The images are divided into 8×8 blocks, and the means over R, G and B of each block are
compared. The picture shows both images and the ratio of each block; the numbers are printed.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import gpf  # noqa: F401  (first: it tells Dr.Jit where libLLVM is)

# ruff: isort: split
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np

from gpf.core.images import tone_map
from gpf.core.runtime import choose_variant
from gpf.scene.snapshot import snapshot_scene

BLOCKS = 8  # per axis
WAVEFRONT = 2**21  # camera paths per batch


@dataclass(frozen=True)
class Estimate:
    """A rendered image and its noise.

    Attributes
    ----------
    image: mean of all batches, (H, W, 3).
    blocks: mean radiance of each block, (BLOCKS, BLOCKS).
    noise: standard error of ``blocks``, from the differences between batches. It is too low where
        a path tracer finds a light only rarely.
    total: mean radiance of the image.
    total_noise: standard error of ``total``.
    """

    image: np.ndarray
    blocks: np.ndarray
    noise: np.ndarray
    total: float
    total_noise: float


def block_means(image: np.ndarray) -> np.ndarray:
    """Mean over R, G, B of each block of an image (H, W, 3): (BLOCKS, BLOCKS)."""
    rows = np.array_split(image.mean(axis=-1), BLOCKS, axis=0)
    return np.array([[b.mean() for b in np.array_split(row, BLOCKS, axis=1)] for row in rows])


def camera_of(scene: mi.Scene, width: int, height: int) -> mi.Sensor:
    """The scene's first camera, with an RGB film of this size and a box filter."""
    values = mi.traverse(scene.sensors()[0])
    matrix = np.array(values["to_world"].matrix).reshape(4, 4)
    film = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb"}
    return mi.load_dict(
        {
            "type": "perspective",
            "fov_axis": "x",
            "fov": float(np.array(values["x_fov"]).item()),
            "to_world": mi.ScalarTransform4f(matrix),
            "film": {**film, "component_format": "float32", "rfilter": {"type": "box"}},
        }
    )


def estimate(
    scene: mi.Scene, sensor: mi.Sensor, integrator: mi.Integrator, spp: int, seed: int
) -> Estimate:
    """Render ``spp`` samples in each pixel, in independent batches (at least eight)."""
    width, height = (int(n) for n in sensor.film().size())
    count = max(8, -(-spp * width * height // WAVEFRONT))
    image = np.zeros((height, width, 3))
    blocks, totals = np.zeros((count, BLOCKS, BLOCKS)), np.zeros(count)
    for i in range(count):
        batch = mi.render(
            scene, sensor=sensor, integrator=integrator, spp=-(-spp // count), seed=seed + i
        )
        pixels = np.array(batch, dtype=float)
        blocks[i] = block_means(pixels)
        image += pixels / count
        totals[i] = pixels.mean()
    root = np.sqrt(count)
    return Estimate(
        image,
        blocks.mean(axis=0),
        blocks.std(axis=0, ddof=1) / root,
        float(totals.mean()),
        float(totals.std(ddof=1) / root),
    )


def ratios(original: Estimate, own: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Own radiance / original radiance of each block and its standard error, (BLOCKS, BLOCKS)."""
    ratio = own.blocks / original.blocks
    return ratio, ratio * np.hypot(own.noise / own.blocks, original.noise / original.blocks)


def report(original: Estimate, own: Estimate) -> str:
    """The numbers as text."""
    ratio, noise = ratios(original, own)
    off = np.abs(ratio - 1)
    worst = np.unravel_index(np.argmax(off), off.shape)
    total = own.total / original.total
    parts = own.total_noise / own.total, original.total_noise / original.total
    return "\n".join(
        [
            f"mean radiance: original {original.total:.4f}, own {own.total:.4f}, "
            f"ratio {total:.4f} ± {total * np.hypot(*parts):.4f}",
            f"blocks: median difference {np.median(off):.2%}, largest {off.max():.2%} ± "
            f"{noise[worst]:.2%} in row {worst[0]}, column {worst[1]} (from 0, at the top left)",
            f"standard error of the blocks' ratios: median {np.median(noise):.2%}, "
            f"largest {noise.max():.2%}",
        ]
    )


def draw(original: Estimate, own: Estimate, exposure: float, out: Path) -> None:
    """Write the picture: the original, the own scene, the ratio of each block and its noise."""
    height, width = original.image.shape[:2]
    figure, axes = plt.subplots(
        1, 3, figsize=(13.2, 4.4 * height / width + 0.5), layout="constrained"
    )
    for ax, title, found in zip(axes, ("original", "own model"), (original, own), strict=False):
        ax.imshow(tone_map(found.image, exposure), interpolation="nearest")
        ax.set_title(f"{title}: mean radiance {found.total:.4f} ± {found.total_noise:.4f}")
    ratio, noise = ratios(original, own)
    axes[2].imshow(ratio, cmap="RdBu_r", vmin=0.6, vmax=1.4, aspect=height / width)
    for (row, column), value in np.ndenumerate(ratio):
        text = f"{value:.3f}\n± {noise[row, column]:.3f}"
        axes[2].text(column, row, text, ha="center", va="center", fontsize=7)
    axes[2].set_title("own / original of each block ± standard error")
    for ax in axes:
        ax.title.set_fontsize(10)
        ax.set_axis_off()
    figure.savefig(out, dpi=100)
    plt.close(figure)


def main() -> None:
    """Read the arguments, render, report and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("original", type=Path, help="the original's Mitsuba scene file")
    parser.add_argument("own", help="the name of the scene that is modelled after it")
    parser.add_argument("--size", default="256x256", help="WIDTHxHEIGHT in pixels")
    parser.add_argument("--spp", type=int, default=1024, help="samples per pixel")
    parser.add_argument("--exposure", type=float, default=1.0, help="of the picture")
    parser.add_argument("--out", type=Path, default=Path("comparison.png"), help="the picture")
    arguments = parser.parse_args()
    width, height = (int(n) for n in arguments.size.split("x"))
    choose_variant("auto")
    with tempfile.TemporaryDirectory() as folder:
        snapshot = Path(folder) / arguments.own
        snapshot_scene(arguments.own, snapshot)
        files = (arguments.original, snapshot / "scene.xml")
        scenes = [mi.load_file(str(file), optimize=False) for file in files]
    sensor, integrator = camera_of(scenes[0], width, height), scenes[0].integrator()
    original, own = (
        estimate(scene, sensor, integrator, arguments.spp, seed=10**6 * i)
        for i, scene in enumerate(scenes)
    )
    print(report(original, own))
    draw(original, own, arguments.exposure, arguments.out)


if __name__ == "__main__":
    main()
