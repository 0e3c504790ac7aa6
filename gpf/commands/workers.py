"""What travels to the workers of a Ray cluster: scenes and fields.

A task brings all that it needs; a worker needs only the same version of this package.
"""

from __future__ import annotations

import io
import logging
import os
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import drjit as dr

from gpf.core.errors import UserError
from gpf.core.runtime import choose_variant
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field, save_field
from gpf.scene.frames import SceneFrame
from gpf.scene.xml import read_scene_xml

PREFIX = "gpf-worker-"


@dataclass(frozen=True)
class SentScenes:
    """Scenes with all files that they refer to.

    Attributes
    ----------
    archive: a zip archive; it has once what several scenes share.
    root: the folder that the archive stands for.
    frames: the scenes; the paths of their files begin at this folder.
    """

    archive: bytes
    root: Path
    frames: tuple[SceneFrame, ...] = field(hash=False)

    @classmethod
    def pack(cls, frames: Sequence[SceneFrame]) -> SentScenes:
        """Scenes, with the files that they refer to with their parameters.

        Raises
        ------
        UserError: a scene file cannot be read. Other files may be missing: the worker says so.
        """
        own = [_absolute(frame.file) for frame in frames]
        files = dict.fromkeys(own)
        for frame in frames:
            found = read_scene_xml(frame.file, frame.parameters).files()
            files |= dict.fromkeys(_absolute(file) for file in found if file.exists())
        root = Path(os.path.commonpath([path.parent for path in files]))
        data = io.BytesIO()
        # Some systems date all files to 1970; zip archives begin in 1980.
        with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED, strict_timestamps=False) as archive:
            for path in files:
                archive.write(path, path.relative_to(root))
        sent = (
            replace(frame, file=file.relative_to(root))
            for frame, file in zip(frames, own, strict=True)
        )
        return cls(data.getvalue(), root, tuple(sent))

    @contextmanager
    def unpacked(self) -> Iterator[list[SceneFrame]]:
        """The scenes on a worker; errors name the files of the machine that has sent them."""
        with tempfile.TemporaryDirectory(prefix=PREFIX) as name:
            folder = Path(name)
            with zipfile.ZipFile(io.BytesIO(self.archive)) as archive:
                archive.extractall(folder)
            try:
                yield [replace(frame, file=folder / frame.file) for frame in self.frames]
            except UserError as error:
                told = (error.where, error.what, error.todo)
                raise UserError(*(text.replace(name, str(self.root)) for text in told)) from error


def _absolute(path: Path) -> Path:
    return Path(os.path.normpath(path.absolute()))


def begin_work() -> None:
    """Prepare a worker's process."""
    choose_variant("auto")
    # At least two: with one, Mitsuba hangs when it reads an EXR file.
    dr.set_thread_count(max(2, os.cpu_count() or 1))


@contextmanager
def kept_warnings() -> Iterator[list[str]]:
    """The warnings that are logged in the block; a worker's log reaches nobody."""
    lines: list[str] = []
    handler, logger = logging.Handler(logging.WARNING), logging.getLogger("gpf")
    handler.emit = lambda record: lines.append(handler.format(record))  # type: ignore[method-assign]
    logger.addHandler(handler)
    try:
        yield lines
    finally:
        logger.removeHandler(handler)


def pack_field(field: GaussianPhotonField) -> bytes:
    """The contents of a field's file."""
    with tempfile.TemporaryDirectory(prefix=PREFIX) as name:
        file = Path(name) / "field.safetensors"
        save_field(field, file)
        return file.read_bytes()


def unpack_field(data: bytes) -> GaussianPhotonField:
    """The field of a file with these contents."""
    with tempfile.TemporaryDirectory(prefix=PREFIX) as name:
        file = Path(name) / "field.safetensors"
        file.write_bytes(data)
        return load_field(file)
