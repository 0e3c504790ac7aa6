"""Files that a page asks for."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gpf.core.films import write_film
from gpf.core.images import write_exr
from gpf.scene.views import SceneViews, View, ViewSets, read_views
from gpf.scene.views_file import write_views

FPS = 24


def add_view(file: Path, view: View, new: SceneViews) -> None:
    """Add a camera to the novel views of a file; without one, to those of ``new``."""
    known = read_views(file, need_training=False) if file.exists() else new
    sets = known.views.model_copy(update={"novel": (*known.views.novel, view)})
    sets = ViewSets.model_validate(sets.model_dump())
    write_views(file, known.model_copy(update={"views": sets}))


def exr_file(radiance: np.ndarray, frames: int) -> bytes:
    """An EXR with a picture, (H, W, 3), that is the mean of so many frames."""
    return _written(lambda path: write_exr(path, {"radiance": radiance}, {"frames": frames}), "exr")


def film_file(pictures: Sequence[np.ndarray]) -> bytes:
    """An MP4 of pictures, display values (H, W, 3) uint8 each."""
    return _written(lambda path: write_film(path, pictures, FPS), "mp4")


def _written(write: Callable[[Path], object], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file.{suffix}"
        write(path)
        return path.read_bytes()
