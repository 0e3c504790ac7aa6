"""Checks of plugin properties, shared by both integrators."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from gpf.core.runtime import check_llvm


def check_variant(plugin: str) -> None:
    """Raise an error for a variant that the plugin does not support, or if its LLVM is missing,
    which would end the process."""
    if mi.is_spectral or mi.is_monochromatic or mi.is_polarized:
        raise ValueError(f"{plugin} needs an RGB variant; this one is {mi.variant()}.")
    if str(mi.variant()).startswith("llvm"):
        check_llvm()


def is_number(value: Any) -> bool:
    """Whether a property is a number; in Python, booleans are integers too."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def whole_number(value: Any, name: str, least: int) -> int:
    """The value of an integer property; a ``ValueError`` if it is not an integer >= ``least``."""
    if not (is_number(value) and isinstance(value, int) and value >= least):
        raise ValueError(f'"{name}" is {value!r}; give a whole number of {least} or more.')
    return value


def read_depths(props: mi.Properties, plugin: str) -> int:
    """Check the variant and the properties that both plugins have; return the depth limit, or -1
    for none.

    Sets the default of ``max_depth`` to -1 before Mitsuba's base class reads it.
    """
    check_variant(plugin)
    if "max_depth" not in props:
        props["max_depth"] = -1
    if props.get("hide_emitters", False):
        raise ValueError(f'"hide_emitters" is not available in {plugin}.')
    whole_number(props.get("rr_depth", 5), "rr_depth", 1)
    return whole_number(props["max_depth"], "max_depth", -1)
