"""A data set with moving caustics: a camera under the waves of a bay, with the sun and without.

    python examples/moving_caustics.py OUT --seconds 10 --frames 24

Who trains a network to see under water needs frames with caustics that dance over the ground, the
same frames without them, and their depth, normals and cameras. Here a scene file has the parameter
$frame in the name of the water's mesh, `gpf fit --frames` fits a field to each frame, which keeps
sun and sky apart, and `gpf render --frames` writes the frames twice: with the sun, and with the sky
alone. OUT receives the scene, the fields, both data sets, and a picture of four frames: with the
sun, with the sky alone, depth and normals.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import typer
from PIL import Image

from gpf.core.progress import say
from gpf.modelling.meshes import Mesh, grid, write_ply
from gpf.modelling.textures import fractal_noise, ramp, write_png
from gpf.modelling.waves import after, spread_waves, water_surface

HALF, CELLS = 3.0, 160  # of the bay, a square; metres
FRAME_RATE = 24
# Wavelength, root-mean-square slope and number of the waves of a band
WAVES = spread_waves(((1.4, 0.03, 4), (0.6, 0.05, 6), (0.35, 0.06, 8)))
SAND = [(0.2, (0.58, 0.52, 0.42)), (0.8, (0.76, 0.70, 0.58))]
STONES = ((-0.5, -0.4, 0.32), (0.35, -0.9, 0.22), (0.7, 0.3, 0.16), (-0.9, -1.3, 0.4))

SCENE = """<scene version="3.0.0">
    <sensor type="perspective" id="camera">
        <float name="fov" value="60"/>
        <transform name="to_world">
            <lookat origin="0.9, -0.55, 1.2" target="-0.1, -1.05, -0.2" up="0, 1, 0"/>
        </transform>
    </sensor>
    <emitter type="directional" id="sun">
        <vector name="direction" x="-0.35" y="-1" z="-0.2"/>
        <rgb name="irradiance" value="5, 4.8, 4.4"/>
    </emitter>
    <emitter type="constant" id="sky"><rgb name="radiance" value="0.35, 0.5, 0.62"/></emitter>
    <shape type="ply" id="water">
        <string name="filename" value="water_$frame.ply"/>
        <bsdf type="dielectric">
            <string name="int_ior" value="water"/>
            <string name="ext_ior" value="air"/>
        </bsdf>
    </shape>
    <shape type="ply" id="ground">
        <string name="filename" value="ground.ply"/>
        <bsdf type="twosided"><bsdf type="diffuse">
            <texture type="bitmap" name="reflectance">
                <string name="filename" value="sand.png"/>
            </texture>
        </bsdf></bsdf>
    </shape>
    {stones}
</scene>
"""
STONE = """<shape type="sphere" id="stone_{k}">
        <point name="center" x="{x}" y="{y}" z="{z}"/><float name="radius" value="{radius}"/>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.35, 0.33, 0.3"/></bsdf>
    </shape>"""
VIEWS = """exposure: 0.7
views:
  train:
    - {{name: main, origin: [0.9, -0.55, 1.2], target: [-0.1, -1.05, -0.2], fov: 60}}
    - {{name: other, origin: [-0.9, -0.5, 0.8], target: [0.1, -1.05, -0.3], fov: 60}}
path:
  frames: {frames}
  closed: false
  keyframes:
    - {{origin: [0.9, -0.55, 1.2], target: [-0.1, -1.05, -0.2], fov: 60}}
    - {{origin: [0.2, -0.5, 1.25], target: [-0.15, -1.05, -0.3], fov: 60}}
    - {{origin: [-0.5, -0.55, 1.0], target: [-0.1, -1.05, -0.4], fov: 60}}
"""


def ground() -> Mesh:
    """Sand that rises above the water on all sides."""
    x = np.linspace(-HALF, HALF, CELLS + 1)
    across, along = np.meshgrid(x, -x)
    far = np.maximum(np.abs(across), np.abs(along)) / HALF
    height = 0.15 * fractal_noise(across.shape, (5, 5), 4, seed=1) - 1.2 + 1.6 * far**4
    places = np.stack([across, height, along], axis=2)
    return grid(places, uv=np.stack([across, along], axis=2) / 2).smooth()


def write_scene(folder: Path, frames: int) -> Path:
    """Write the scene file, its meshes and its views."""
    bed = ground()
    write_ply(folder / "ground.ply", bed)
    write_png(folder / "sand.png", ramp(fractal_noise((512, 512), (24, 24), 5, seed=2), SAND))
    x = np.linspace(-HALF, HALF, CELLS + 1)
    for k in range(frames):
        water = water_surface(after(WAVES, k / FRAME_RATE), x, -x)
        write_ply(folder / f"water_{k:04d}.ply", water)
    stones = []
    for k, (x0, z0, radius) in enumerate(STONES):
        nearest = np.hypot(bed.points[:, 0] - x0, bed.points[:, 2] - z0).argmin()
        y0 = bed.points[nearest, 1] + 0.3 * radius  # a little sunk in
        stones.append(STONE.format(k=k, x=x0, y=y0, z=z0, radius=radius))
    file = folder / "scene.xml"
    file.write_text(SCENE.format(stones="\n    ".join(stones)))
    (folder / "views.yaml").write_text(VIEWS.format(frames=frames))
    return file


def gpf(*words: object) -> None:
    """Run a command."""
    subprocess.run([sys.executable, "-m", "gpf.cli", *map(str, words)], check=True)


def main(folder: Path, seconds: float = 10, size: int = 256, frames: int = 24) -> None:
    """Write scene, fields, the data sets sun and sky, and moving_caustics.png into FOLDER."""
    folder.mkdir(parents=True, exist_ok=True)
    scene, fields = write_scene(folder, frames), folder / "fields"
    say(f"Fitting {frames} frames, for {seconds:g} seconds each.")
    gpf("fit", scene, "--frames", "all", "-o", fields, "--seconds", seconds, "--groups", "auto")
    options = ["--frames", "all", "--field", fields, "--size", f"{size}x{size}"]
    gpf("render", scene, *options, "-o", folder / "sun", "--aovs", "depth,normal", "--mp4")
    gpf("render", scene, *options, "-o", folder / "sky", "--lights", "sun=0", "--mp4")

    columns = []
    for k in range(0, frames, max(1, frames // 4))[:4]:
        name = f"scene_{k:04d}"
        with_sun, sky, normal = (
            np.asarray(Image.open(folder / path).convert("RGB"))
            for path in (f"sun/{name}.png", f"sky/{name}.png", f"sun/{name}_normal.png")
        )
        depth = np.load(folder / f"sun/{name}_depth.npy") / 1000
        grey = np.uint8(255 * np.clip(depth / 3, 0, 1))
        columns.append(np.vstack([with_sun, sky, np.dstack([grey] * 3), normal]))
    Image.fromarray(np.hstack(columns)).save(folder / "moving_caustics.png")


if __name__ == "__main__":
    typer.run(main)
