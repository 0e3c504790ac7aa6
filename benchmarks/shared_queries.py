"""`python -m benchmarks.shared_queries [--seconds S] [SCENE …]`: what sharing queries saves.

Views of a field with 64 adaptive samples per pixel, rendered in turn with walks that share queries
(:class:`gpf.rendering.walks.GroupedWalks`) and with walks that share nothing. A line for each view:
seconds without and with sharing, their ratio, and the PSNR of the noise alone, against an image
with many samples.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.judged import Judged, decibels, open_field, options
from benchmarks.timing import time_in_turn
from gpf.core.images import tone_map
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.rendering.walks import GroupedWalks

ROWS, VIEWS, ROUNDS = 256, 2, 3
MANY = RenderSettings(spp=576, suppress_fireflies=False)
KINDS = {"apart": lambda walks, *more: walks, "shared": GroupedWalks}


def main() -> None:
    """Print a table for each scene."""
    arguments = options(__doc__.splitlines()[0], passes=200).parse_args()
    for name in arguments.scenes:
        scene, field, judged = open_field(name, ROWS, None, arguments)
        renderer, many = (
            FieldRenderer.make(scene, field, settings) for settings in (RenderSettings(), MANY)
        )
        table = Table("view", "s, apart", "s, shared", "ratio", "noise, apart", "noise, shared")
        table.title = name
        for number in range(VIEWS):
            table.add_row(*compare(renderer, many, judged, number))
        Console(width=110).print(table)


def compare(renderer: FieldRenderer, many: FieldRenderer, judged: Judged, number: int) -> list[str]:
    """The cells of a view."""
    import gpf.rendering.gpf as plugin  # needs a variant

    view, images = judged.views[number], {}

    def render(kind: str, seed: int) -> None:
        plugin.GroupedWalks = KINDS[kind]  # type: ignore[misc, assignment]
        image = renderer.render(view, judged.size, seed)["radiance"]
        images[kind, seed] = tone_map(image, judged.exposure)

    timings = time_in_turn({kind: partial(render, kind) for kind in KINDS}, ROUNDS, warm_up=1)
    plugin.GroupedWalks = KINDS["apart"]  # type: ignore[misc, assignment]
    truth = tone_map(many.render(view, judged.size, 100)["radiance"], judged.exposure)
    noise = [
        decibels(np.mean([(images[kind, seed] - truth) ** 2 for seed in range(ROUNDS)]))
        for kind in KINDS
    ]
    return [
        view.name,
        *(f"{1e-3 * timings.milliseconds(kind):.2f}" for kind in KINDS),
        f"{1 / timings.ratio('shared', 'apart'):.2f}",
        *noise,
    ]


if __name__ == "__main__":
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    main()
