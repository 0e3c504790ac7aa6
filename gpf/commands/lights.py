"""`gpf lights`: the groups of emitters that a field keeps apart."""

from __future__ import annotations

import numpy as np

from gpf.commands.scenes import find_field
from gpf.core.progress import say
from gpf.field.io import read_field


def list_lights(field: str) -> None:
    """Print a line for each group: its name and its share of the light in the field.

    Raises
    ------
    UserError: the file cannot be read.
    """
    stored = read_field(find_field(field))
    groups = stored.groups()
    if groups is None:
        say(f"{field}: no groups. `gpf fit --groups auto` keeps the emitters' light apart.")
        return
    light = stored.tensors["lights"].astype(np.float64).mean(axis=(1, 2))
    for name, share in zip(groups.names, light / max(light.sum(), 1e-30), strict=True):
        print(f"{name}\t{share:.1%}")
