"""`gpf info`: what a field is, where it is from, how good it is, its groups."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gpf.commands.fit import describe_fit
from gpf.commands.scenes import find_field, read_given
from gpf.field.io import StoredField


def print_info(name: str | None) -> None:
    """Print what a field's file says, a line for each fact; a :class:`UserError` if it cannot be
    read."""
    file = find_field(name)
    for fact, text in _facts(file, read_given(file)):
        print(f"{fact:<9}{text}")


def _shares(stored: StoredField) -> list[tuple[str, float]]:
    if (groups := stored.groups()) is None:
        return []
    light = stored.tensors["lights"].astype(np.float64).mean(axis=(1, 2))
    return list(zip(groups.names, light / max(light.sum(), 1e-30), strict=True))


def _facts(file: Path, stored: StoredField) -> Iterator[tuple[str, str]]:
    """The facts that the file has."""
    record, direct = stored.record, stored.settings.direct
    haze = f" and {len(stored.volume.tensors['means']):,} in media" if stored.volume else ""
    megabytes = file.stat().st_size / 1e6
    yield "field", f"{len(stored.tensors['means']):,} Gaussians{haze}, {megabytes:.1f} MB"
    size = " x ".join(f"{side:.4g}" for side in np.diff(stored.bounds, axis=0)[0])
    yield "scene", f"{record.get('name') or 'without a name'}, {size} units"
    if "seconds" in record:
        when = f"{record['date']}, " if "date" in record else ""
        yield "fit", f"{when}{record['passes']} passes in {record['seconds']:.0f} s"
    if "fields" in record:
        yield "quality", describe_fit(record)
    if "error" in stored.tensors:
        error = np.median(stored.tensors["error"])
        yield "error", f"{error:.1%} of the light, at half of the Gaussians less"
    lamps = "all emitters" if direct == "emitters" else f"{len(direct)} emitters"
    yield "light", "all" if direct == "field" else f"without the direct light of {lamps}"
    groups = [f"{group} {share:.1%}" for group, share in _shares(stored)]
    yield (
        "groups",
        ", ".join(groups) or "none; `gpf fit --groups auto` keeps them apart",
    )
