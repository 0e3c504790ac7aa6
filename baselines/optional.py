"""Packages that only one system needs."""

from __future__ import annotations

import importlib
from typing import Any

from baselines.protocol import CannotServe


def import_optional(module: str, package: str) -> Any:
    """Import a module; if it is missing, raise :class:`CannotServe` with the install command."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise CannotServe(
            module, f"package not installed: {package} ({error})", f"Run `pip install {package}`."
        ) from error
