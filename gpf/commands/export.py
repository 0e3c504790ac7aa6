"""`gpf export`: write a field as splats for viewers, or at a third of its size."""

from __future__ import annotations

import math
from pathlib import Path

from gpf.commands.cameras import file_beside
from gpf.commands.overwriting import require_new
from gpf.commands.scenes import find_field, known_exposure, read_given
from gpf.core.errors import UserError
from gpf.core.progress import say
from gpf.field.io import write_field
from gpf.field.ply import propose_exposure, write_splats


def export_field(
    field: str | None,
    ply: Path | None,
    compact: Path | None,
    exposure: float | None,
    overwrite: bool = False,
) -> None:
    """Write a field as splats, as a compact field, or both.

    Parameters
    ----------
    field: as for :func:`gpf.commands.scenes.find_field`.
    ply, compact: the files to write.
    exposure: exposure of the splats; by default that of ``views.yaml`` beside the field, or that of
        the fit, or one that suits the field.
    overwrite: whether to replace files that exist.

    Raises
    ------
    UserError: an option is wrong, or a file cannot be read or written.
    """
    check_options(ply, compact, exposure)
    source = find_field(field)
    for target in (ply, compact):
        if target is not None and target.resolve() == source.resolve():
            raise UserError(str(target), "is the field itself", "Choose another name.")
        if target is not None:
            require_new(target, overwrite)
    stored = read_given(source)
    if ply is not None:
        if exposure is None:
            views = file_beside(source, None)
            exposure = known_exposure(views, stored) or propose_exposure(stored)
        count = write_splats(ply, stored, exposure)
        if stored.settings.direct != "field":
            say(f"{source} does not store the direct light of all emitters; neither do the splats")
        report(ply, f"{count} splats, exposure {exposure:.4g}")
    if compact is not None:
        write_field(stored, compact, "compact")
        report(compact, f"{compact.stat().st_size / source.stat().st_size:.0%} of {source}")


def check_options(ply: Path | None, compact: Path | None, exposure: float | None) -> None:
    """Raise a :class:`UserError` if an option is wrong."""
    if ply is None and compact is None:
        raise UserError(
            "gpf export",
            "has nothing to write",
            "Add --ply OUT.ply or --compact OUT.safetensors.",
        )
    for option, target, suffix in (("ply", ply, ".ply"), ("compact", compact, ".safetensors")):
        if target is not None and target.suffix.lower() != suffix:
            raise UserError(
                f"--{option} {target}", f"does not end in {suffix}", "Give it a name that does."
            )
    if exposure is not None:
        if ply is None:
            raise UserError(f"--exposure {exposure}", "is only for --ply", "Leave it out.")
        if not 0 < exposure < math.inf:
            raise UserError(
                f"--exposure {exposure}", "is not an exposure", "Give a number above 0."
            )


def report(path: Path, what: str) -> None:
    """Print a line about a file that was written."""
    size = path.stat().st_size / 1e6
    say(f"{path}: {size:.1f} MB, {what}")
