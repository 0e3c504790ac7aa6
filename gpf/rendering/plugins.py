"""The Mitsuba plugins ``sppm`` and ``gpf``."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

_MODULES = ("gpf.rendering.sppm", "gpf.rendering.gpf")


def register_integrators() -> None:
    """Register the plugins for the active variant and for every one that is set later.

    Mitsuba keeps classes and plugin registrations per variant, so that a plugin's class has to
    be made anew after each change of variant.
    """
    if importlib.util.find_spec("mitsuba") is None:
        return  # `gpf doctor` has to start in a broken installation, to say so
    import mitsuba as mi

    mi.detail.add_variant_callback(_on_variant_change)
    if mi.variant() is not None:
        _register()


def _on_variant_change(old: str | None, new: str | None) -> Any:
    if new is not None and new != old:
        _register()


def _register() -> None:
    import mitsuba as mi

    # Scalar variants have no wavefront: the plugins need the vectorised ones.
    variant = mi.variant() or ""
    if not variant.startswith(("llvm", "cuda")):
        return
    for name in _MODULES:
        importlib.import_module(name).register()
