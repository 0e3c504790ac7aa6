"""What `gpf bake` is asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from gpf.baking.three_js import find_three
from gpf.blender.process import find_blender
from gpf.commands import options
from gpf.core.errors import UserError


@dataclass(frozen=True)
class BakeOptions:
    """What is baked: the options of the command; their help is the explanation."""

    size: options.MapSize = None
    texels_per_unit: options.TexelsPerUnit = None
    vertex_colours: options.VertexColours = False
    spp: options.BakeSpp = 16
    exposure: options.Exposure = None
    glb: options.SceneGlb = None
    html: options.ScenePage = None
    three: options.Three = None
    blend: options.SceneBlend = None
    seed: options.Seed = 0
    changed_scene: options.ChangedScene = False
    overwrite: options.Overwrite = False

    def files(self) -> dict[str, Path]:
        """The further files that are asked for, by their options."""
        named = {"--glb": self.glb, "--html": self.html, "--blend": self.blend}
        return {option: file for option, file in named.items() if file is not None}

    def check(self) -> None:
        """Raise a :class:`UserError` for what is wrong whatever the scene and the field are; also
        without Blender or three.js, if they are needed."""
        given = {
            "--size": self.size is not None,
            "--texels-per-unit": self.texels_per_unit is not None,
            "--vertex-colours": self.vertex_colours,
        }
        if sum(given.values()) > 1:
            names = " and ".join(name for name, is_given in given.items() if is_given)
            raise UserError(names, "are mutually exclusive", "Give one of them.")
        if self.blend is not None:
            find_blender()
        for option in self.files():
            if self.vertex_colours:
                raise UserError(
                    f"{option} and --vertex-colours", "are mutually exclusive", "Bake maps for it."
                )
        for option, value in (
            ("--texels-per-unit", self.texels_per_unit),
            ("--exposure", self.exposure),
        ):
            if value is not None and not 0 < value < math.inf:
                raise UserError(f"{option} {value}", "is out of range", "Give a number above 0.")
        if self.html is not None:
            find_three(self.three)
        elif self.three is not None:
            raise UserError("--three", "is for the page of --html", "Leave it out.")
