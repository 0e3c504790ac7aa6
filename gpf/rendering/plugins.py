"""The project's Mitsuba plugins, registered in every variant."""

from __future__ import annotations

import importlib
import importlib.util
import sys

_MODULES = ("gpf.scene.principled", "gpf.rendering.sppm", "gpf.rendering.gpf")


def register_plugins() -> None:
    """Register the plugins for the active variant and for every one that is set later."""
    if importlib.util.find_spec("mitsuba") is None:
        return  # `gpf doctor` must also start in a broken installation, to report it
    import mitsuba as mi

    mi.detail.add_variant_callback(_on_variant_change)
    _on_variant_change(None, mi.variant())


def _on_variant_change(old: str | None, new: str | None) -> None:
    """Import or reload the modules of the plugins, because their base classes depend on the
    variant.

    Mitsuba reloads its own Python integrators in the same way. Scalar variants are skipped: the
    plugins need wavefronts.
    """
    if new is None or new == old or not new.startswith(("llvm", "cuda")):
        return
    for name in _MODULES:
        if name in sys.modules:
            importlib.reload(sys.modules[name])
        else:
            importlib.import_module(name)
