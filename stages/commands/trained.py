"""Fields of trained scenes, for commands that take a scene's name in place of a file."""

from __future__ import annotations

from pathlib import Path

from gpf.core.errors import UserError
from gpf.core.yaml import suggest

RESULTS = Path("results")


def find_field(scene: str) -> Path:
    """The field of a scene.

    Raises
    ------
    UserError: there is none.
    """
    trained = {p.parent.name: p for p in sorted(RESULTS.glob("*/field.safetensors"))}
    if scene in trained:
        return trained[scene]
    todo = suggest(scene, list(trained), "There are fields of") if trained else ""
    raise UserError(
        scene,
        f"is neither a file nor a scene with {RESULTS / scene / 'field.safetensors'}",
        todo or f"Run `gpf stage train --scene {scene}` first.",
    )
