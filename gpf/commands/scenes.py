"""Scenes that commands are given, and whether a field is for them."""

from __future__ import annotations

import importlib
from pathlib import Path

import mitsuba as mi

from gpf.core.checkout import CHECKOUT
from gpf.core.errors import UserError
from gpf.field.field import GaussianPhotonField
from gpf.scene.fingerprint import changed_parts, fingerprint


def find_scene(name: str) -> tuple[Path, Path | None]:
    """The file of a scene, and, for the name of a trained scene, the folder of its results."""
    path = Path(name)
    if path.suffix or len(path.parts) > 1 or path.is_file() or CHECKOUT is None:
        return path, None
    field = Path(importlib.import_module("stages.commands.trained").find_field(name))
    return field.parent / "scene" / "scene.xml", field.parent


def require_same_scene(
    scene: mi.Scene,
    scene_file: Path,
    field: GaussianPhotonField,
    field_file: Path,
    changed_scene: bool = False,
) -> None:
    """Raise a :class:`UserError` if a field was fitted to another scene, or to this one before it
    was changed; fields that do not say so are taken as they are.

    The plugin does not ask again: from now on, lamps may be dimmed.

    Parameters
    ----------
    changed_scene: whether a field of another scene is accepted.
    """
    known = field.record.pop("fingerprint", None)
    if changed_scene or not known:
        return
    if changed := changed_parts(known, fingerprint(scene)):
        parts = " and ".join(", ".join(changed).rsplit(", ", 1))
        raise UserError(
            str(field_file),
            f"was fitted to another scene, or before {scene_file} was changed: other {parts}",
            "Run `gpf fit` again, or add --changed-scene to see the light of the other scene.",
        )
