"""Cycles, the path tracer of Blender, in a process of its own."""

from __future__ import annotations

from typing import Any

from baselines.official import Program
from baselines.options import CyclesOptions
from baselines.peer import PreparedPeer, seconds_for, write_description
from baselines.protocol import CannotServe, Task
from gpf.blender.process import find_blender
from gpf.core.errors import UserError


class Blender:
    """Blender, as :mod:`gpf.blender.process` finds it."""

    name = "cycles"
    install = "gpf blender-install"

    def command(self) -> list[str]:
        """The command that runs a script; raises :class:`CannotServe` if there is no Blender."""
        try:
            return find_blender()
        except UserError as error:
            raise CannotServe(
                self.name, "package not installed: Blender", f"Run `{self.install}` (400 MB)."
            ) from error

    def settings(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def advice(self) -> str:
        """What to do if a script ends."""
        return f"{self.command()[0]} ran it."


HOST = Blender()


class Cycles:
    """Cycles at the settings that Blender's manual recommends for such scenes: path guiding, Open
    Image Denoise with albedo and normals, and shadow caustics where lamps and smooth glass allow.

    If denoising takes most of the time, a faster quality is chosen, or none.
    """

    def __init__(self, options: CyclesOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedPeer:
        """Translate the scene, load it, and measure what a view takes apart from its samples.

        Raises
        ------
        CannotServe: the scene has something that is not translated, Blender is missing, or a view
            takes too long.
        """
        seconds = seconds_for(self.options.seconds, task)
        HOST.command()
        settings = {
            "folder": str(write_description(task)),
            "guiding": self.options.guiding,
            "caustics": self.options.shadow_caustics,
        }
        program = Program(HOST, "render_with_cycles.py", settings, task.state.absolute())
        qualities = ("accurate", "fast", "none") if self.options.denoise else ("none",)
        choices = [{"denoiser": quality} for quality in qualities]
        prepared = PreparedPeer(task, program, seconds, choices)
        prepared.measure()
        return prepared
