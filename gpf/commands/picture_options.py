"""How the pictures of `gpf render` are made."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gpf.core.cluster import ClusterChoice
from gpf.core.errors import UserError
from gpf.core.films import find_encoder
from gpf.core.machine import require_memory
from gpf.rendering.aovs import parse_aovs
from gpf.rendering.denoiser import PACKAGE
from gpf.rendering.denoiser import available as has_denoiser
from gpf.rendering.settings import RenderSettings

ROWS = 256
"""Rows of a picture, if no size is given."""


@dataclass(frozen=True)
class PictureOptions:
    """How the pictures are made.

    Attributes
    ----------
    size: ``WIDTHxHEIGHT`` or the number of rows alone; None for :data:`ROWS` rows.
    spp: samples per pixel; None for the default of :class:`RenderSettings`.
    seconds: time for a picture's samples, instead of their number.
    aovs: further layers of the EXR files, separated by commas.
    exposure: exposure of the PNG files; None for that of the views' file or of the field, or else a
        measured one.
    denoise: whether to denoise; None to do so if the package for it is installed.
    film: whether to write an MP4.
    seed: random seed.
    changed_scene: whether to accept a field of another scene.
    executor: ``local``, or ``ray`` to spread the pictures over a cluster.
    cluster: address of the cluster; empty to start one on this machine.
    lights: levels of groups of emitters (:func:`gpf.scene.light_groups.parse_levels`).
    overwrite: whether to replace pictures that were made in another way.
    """

    size: str | None = None
    spp: int | None = None
    seconds: float | None = None
    aovs: str = ""
    exposure: float | None = None
    denoise: bool | None = None
    film: bool = False
    seed: int = 0
    changed_scene: bool = False
    executor: str = "local"
    cluster: str = ""
    lights: str = ""
    overwrite: bool = False

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
            find_encoder()  # before the frames are rendered

    def layers(self) -> tuple[str, ...]:
        """The names of the further layers."""
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
        """The number of samples, and whether to denoise."""
        denoise = has_denoiser() if self.denoise is None else self.denoise
        if denoise and not has_denoiser():
            raise UserError(
                "--denoise", "needs the package pyoidn", f"Run `pip install {PACKAGE}`."
            )
        return RenderSettings(spp=self.spp or RenderSettings().spp, denoise=denoise)
