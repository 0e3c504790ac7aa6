"""Packages that one system needs and the others do not."""

from __future__ import annotations

import importlib
from typing import Any

from gpf.baselines.protocol import CannotServe


def import_optional(module: str, package: str) -> Any:
    """Import a module, or raise :class:`CannotServe` with the command that brings its package."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise CannotServe(
            module, f"package not installed: {package} ({error})", f"pip install {package}"
        ) from error
