"""Checks of plugin properties that both integrators share."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from gpf.core.runtime import check_llvm


def check_variant(plugin: str) -> None:
    """Raise for a variant that the plugin is not made for, or that would end the process."""
    if mi.is_spectral or mi.is_monochromatic or mi.is_polarized:
        raise ValueError(f"{plugin} needs an RGB variant; this one is {mi.variant()}.")
    if str(mi.variant()).startswith("llvm"):
        check_llvm()


def is_number(value: Any) -> bool:
    """Whether a property is a number; Python counts truth values among them."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def whole_number(value: Any, name: str, least: int) -> int:
    """The value of an integer property, or a ``ValueError`` in words."""
    if not (is_number(value) and isinstance(value, int) and value >= least):
        raise ValueError(f'"{name}" is {value!r}; give a whole number of {least} or more.')
    return value


def read_depths(props: mi.Properties, plugin: str) -> int:
    """Check the variant and the properties that both plugins have; the depth limit, -1 for none.

    Mitsuba's base class reads ``max_depth`` and ``rr_depth`` next; its own default of the former
    is replaced by -1.
    """
    check_variant(plugin)
    if "max_depth" not in props:
        props["max_depth"] = -1
    if props.get("hide_emitters", False):
        raise ValueError(f'"hide_emitters" is not available in {plugin}.')
    whole_number(props.get("rr_depth", 5), "rr_depth", 1)
    return whole_number(props["max_depth"], "max_depth", -1)
