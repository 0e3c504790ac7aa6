"""Files that a page requests."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import numpy as np

from gpf.core.errors import UserError
from gpf.core.films import write_film
from gpf.core.images import write_exr
from gpf.scene.views import Keyframe, SceneViews, View, name_view, read_views
from gpf.scene.views_file import write_views

FPS = 24


def add_view(
    file: Path, camera: Keyframe, name: str, taken: Collection[str], new: SceneViews
) -> View:
    """Add a camera to the views in a file, or to ``new`` if there is no file: to the training views
    if there are none yet, else to the novel ones.

    Parameters
    ----------
    camera: the camera, with ``fov`` across x.
    name: the view's name, which gets a number if it is among ``taken`` or in the file.
    """
    known = read_views(file, need_training=False) if file.exists() else new
    sets = known.views
    names = {*taken, *(view.name for view in (*sets.train, *sets.novel, *sets.more))}
    view = View(**camera.model_dump(), name=name_view(name, names, otherwise="saved"), fov_axis="x")
    kind = "novel" if sets.train else "train"
    sets = sets.model_copy(update={kind: (*getattr(sets, kind), view)})
    write_views(file, known.model_copy(update={"views": sets}))
    return view


def exr_file(radiance: np.ndarray, frames: int) -> bytes:
    """An EXR with a picture, (H, W, 3), the mean of this many frames."""
    return _written(lambda path: write_exr(path, {"radiance": radiance}, {"frames": frames}), "exr")


class Film:
    """Pictures for an MP4, kept in a file: in memory, hundreds would take gigabytes."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115  # closed in __exit__
        self._shape, self._count = (0, 0, 0), 0

    def __enter__(self) -> Film:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def add(self, picture: np.ndarray) -> None:
        """Add a picture, display values (H, W, 3) uint8, of the same size as the others."""
        self._shape, self._count = picture.shape, self._count + 1
        try:
            self._file.write(picture.tobytes())
        except OSError as error:
            raise UserError(
                tempfile.gettempdir(), f"has no room for a film ({error})", "Free some disk space."
            ) from error

    def encode(self) -> bytes:
        """The MP4."""
        self._file.seek(0)
        return _written(lambda path: write_film(path, self._pictures(), FPS), "mp4")

    def _pictures(self) -> Iterator[np.ndarray]:
        for _ in range(self._count):
            data = self._file.read(math.prod(self._shape))
            yield np.frombuffer(data, np.uint8).reshape(self._shape)


def _written(write: Callable[[Path], object], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file.{suffix}"
        write(path)
        return path.read_bytes()
