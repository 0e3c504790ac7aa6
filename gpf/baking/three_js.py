"""three.js, which the pages of `gpf bake --html` contain: from where it is published, kept in the
user's cache. It is not a part of this package."""

from __future__ import annotations

import hashlib
import subprocess
import tarfile
import tempfile
import urllib.request
import zlib
from contextlib import suppress
from http.client import HTTPException
from pathlib import Path

import platformdirs

from gpf.core.errors import UserError
from gpf.core.partial import partial_folder, replace_folder
from gpf.core.subprocesses import last_line

VERSION = "0.185.0"

FILES = (
    "build/three.core.min.js",
    "build/three.module.min.js",
    "examples/jsm/utils/BufferGeometryUtils.js",
    "examples/jsm/utils/SkeletonUtils.js",
    "examples/jsm/controls/OrbitControls.js",
    "examples/jsm/loaders/GLTFLoader.js",
    "LICENSE",
)
"""The files that pages need, each after those that it imports."""

SHA256 = "6994fd08c49ad57d90454f01849ab1648609a8af632264f95a5ab1c12affb8b3"
"""Of all these files, one after the other."""

CDN = f"https://cdn.jsdelivr.net/npm/three@{VERSION}"

SECONDS = 60
"""Longest time for a download."""


def kept_three() -> Path:
    """The folder in the user's cache."""
    return platformdirs.user_cache_path("gpf") / f"three-{VERSION}"


def find_three(given: Path | None = None) -> Path:
    """A folder with :data:`FILES`: the one that is given, or the one in the cache, which is filled
    by `npm`, or from a content delivery network.

    Raises
    ------
    UserError: the files are not there, are not those of :data:`VERSION`, or cannot be had.
    """
    todo = f"Give the folder of the npm package three, version {VERSION}, as --three FOLDER."
    if given is not None:
        if wrong := _wrong(given):
            raise UserError(f"--three {given}", wrong, todo)
        return given
    folder = kept_three()
    if not _wrong(folder):
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    failures = []
    for get in (_from_npm, _from_cdn):
        with partial_folder(folder) as staging:
            try:
                get(staging)
                if not (wrong := _wrong(staging)):
                    with suppress(OSError):  # another run has made it in the meantime
                        replace_folder(staging, folder)
                    wrong = _wrong(folder)
            except (OSError, ValueError, EOFError, zlib.error, HTTPException) as error:
                wrong = str(error)
        if not wrong:
            return folder
        failures.append(wrong)
    raise UserError(
        f"three.js {VERSION}, for --html", f"cannot be had: {'; '.join(failures)}", todo
    )


def _wrong(folder: Path) -> str:
    """What is wrong with the files of a folder."""
    digest = hashlib.sha256()
    for name in FILES:
        if not (folder / name).is_file():
            return f"has no {name}"
        digest.update((folder / name).read_bytes())
    return "" if digest.hexdigest() == SHA256 else f"has files of another version than {VERSION}"


def _from_npm(folder: Path) -> None:
    with tempfile.TemporaryDirectory() as work:
        words = ["npm", "pack", "--silent", f"three@{VERSION}"]
        try:
            done = subprocess.run(words, cwd=work, capture_output=True, text=True, timeout=SECONDS)
        except subprocess.TimeoutExpired as error:
            raise OSError(f"npm took more than {SECONDS} s") from error
        if done.returncode:
            raise OSError(f"npm: {last_line(done.stderr)}")
        (packed,) = Path(work).glob("*.tgz")
        with tarfile.open(packed) as archive:
            for name in FILES:
                if (member := archive.extractfile(f"package/{name}")) is not None:
                    _write(folder / name, member.read())


def _from_cdn(folder: Path) -> None:
    for name in FILES:
        with urllib.request.urlopen(f"{CDN}/{name}", timeout=SECONDS) as answer:
            _write(folder / name, answer.read())


def _write(file: Path, data: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)
