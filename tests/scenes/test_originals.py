"""The rooms agree with the originals that they are modelled after, where those are present."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gpf.scene.load import load_scene, load_scene_file
from gpf.scene.sensors import make_sensor, views_of_sensors
from gpf.sppm.passes import PassSettings
from stages.references.renderer import ReferenceRenderer

ORIGINALS = Path(__file__).parents[3] / "shared/scenes"
BLOCKS = 8


def block_means(scene, sensor, settings: PassSettings, passes: int, seed: int) -> np.ndarray:
    """Mean radiance of 8×8 blocks by photon mapping, which converges here; paths do not."""
    renderer = ReferenceRenderer(scene, {"view": sensor}, {}, settings, seed)
    sums = renderer.run(passes)
    image = renderer.image("view", sums).mean(axis=-1)
    rows, columns = (n // BLOCKS for n in image.shape)
    return image.reshape(BLOCKS, rows, BLOCKS, columns).mean(axis=(1, 3))


@pytest.mark.long
@pytest.mark.skipif(
    not ORIGINALS.is_dir(),
    reason="needs the original scenes, no part of this repository",
)
@pytest.mark.parametrize(
    ("name", "size", "paths", "radius"),
    [
        ("veach_ajar", (128, 72), 500_000, 0.15),
        ("veach_bidir", (72, 72), 200_000, 0.1),
    ],
)
def test_radiance_by_blocks(name, size, paths, radius, root):
    settings = PassSettings(photons_per_pass=paths, initial_radius=radius, direct="photons")
    original = load_scene_file(ORIGINALS / name.replace("_", "-") / "scene.xml")
    own = load_scene(name, root=root)
    sensor = make_sensor(views_of_sensors(original)[0], *size)
    # The same random numbers for both: what is left of the noise is mostly common to them.
    theirs, ours = (block_means(scene, sensor, settings, 24, seed=1) for scene in (original, own))
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.05)
    off = np.abs(ours / theirs - 1)
    assert np.median(off) < 0.08
    assert off.max() < 0.2
