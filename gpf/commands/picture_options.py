"""How the pictures of `gpf render` are made.

The command line imports this module whatever the command: slow imports are in the functions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gpf.commands import options
from gpf.core.cluster import ClusterChoice
from gpf.core.errors import UserError
from gpf.core.machine import require_memory

if TYPE_CHECKING:
    from gpf.rendering.settings import RenderSettings

ROWS = 256
"""Rows of a picture, if no size is given."""


@dataclass(frozen=True)
class PictureOptions:
    """How the pictures are made: the options of the command; their help is the explanation."""

    size: options.Size = None
    spp: options.Spp = None
    seconds: options.PictureSeconds = None
    aovs: options.Aovs = ""
    exposure: options.Exposure = None
    denoise: options.Denoise = None
    gather: options.Gather = "auto"
    film: options.Film = False
    seed: options.Seed = 0
    changed_scene: options.ChangedScene = False
    executor: options.Executor = "local"
    cluster: options.Cluster = ""
    lights: options.Levels = ""
    overwrite: options.Overwrite = False

    def check(self) -> None:
        """Raise a :class:`UserError` for what is wrong whatever the scene and the field are."""
        self.layers()
        for option, value in (("seconds", self.seconds), ("exposure", self.exposure)):
            if value is not None and not 0 < value < math.inf:  # or NaN
                raise UserError(
                    f"--{option}", f"is {value}", "Give a number above 0, or leave it out."
                )
        ClusterChoice.of_options(self.executor, self.cluster)
        if self.film:
            from gpf.core.films import find_encoder

            find_encoder()  # before the frames are rendered

    def layers(self) -> tuple[str, ...]:
        """The names of the further layers."""
        from gpf.rendering.aovs import parse_aovs

        try:
            return parse_aovs(self.aovs)
        except ValueError as error:
            what, _, todo = str(error).partition("; ")
            what = what.partition(": ")[2]
            raise UserError(f"--aovs {self.aovs}", what, todo.capitalize()) from None

    def film_size(self, aspect: float) -> tuple[int, int]:
        """Width and height, pixels; ``aspect`` is their ratio if only the rows are given."""
        words = (self.size or str(ROWS)).lower().split("x")
        try:
            numbers = [int(word) for word in words]
        except ValueError:
            numbers = []
        if len(numbers) not in (1, 2) or not all(4 <= n <= 16384 for n in numbers):
            todo = "Give WIDTHxHEIGHT, such as 512x512, or rows alone."
            raise UserError(f"--size {self.size}", "is not a size", todo)
        rows = numbers[-1]
        width = numbers[0] if len(numbers) == 2 else max(1, round(rows * aspect))
        require_memory("--size", f"{width}x{rows}", 40 * width * rows)  # layers, and copies of them
        return width, rows

    def render_settings(self) -> RenderSettings:
        """The number of samples, and whether to denoise and to gather."""
        from gpf.rendering.denoiser import PACKAGE, available
        from gpf.rendering.settings import RenderSettings

        denoise = available() if self.denoise is None else self.denoise
        if denoise and not available():
            raise UserError(
                "--denoise", "needs the package pyoidn", f"Run `pip install {PACKAGE}`."
            )
        spp = self.spp or RenderSettings().spp
        return RenderSettings(spp=spp, denoise=denoise, gather=self.gather)
