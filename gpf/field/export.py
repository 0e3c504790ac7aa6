"""`gpf export`: a field for other programs, or smaller."""

from __future__ import annotations

import math
from pathlib import Path

from gpf.core.errors import UserError
from gpf.core.progress import say
from gpf.core.yaml import suggest
from gpf.field.io import StoredField, read_field, write_field
from gpf.field.ply import propose_exposure, write_splats
from gpf.scene.views import read_views

RESULTS = Path("results")


def export_field(
    field: str, ply: Path | None, compact: Path | None, exposure: float | None
) -> None:
    """Write a field, given by its path or its scene's name, as splats or compactly, or both."""
    check_options(ply, compact, exposure)
    source = find_field(field)
    for target in (ply, compact):
        if target is not None and target.resolve() == source.resolve():
            raise UserError(str(target), "is the field itself", "Choose another name.")
    stored = read(source)
    if ply is not None:
        if exposure is None:
            exposure = known_exposure(source, stored)
        write_splats(ply, stored, exposure)
        if stored.settings.direct == "emitters":
            say(f"{source} has indirect light alone (field.direct: emitters), and the splats too")
        tell(ply, f"{len(stored.tensors['means'])} splats, exposure {exposure:.4g}")
    if compact is not None:
        write_field(stored, compact, "compact")
        tell(compact, f"{compact.stat().st_size / source.stat().st_size:.0%} of {source}")


def check_options(ply: Path | None, compact: Path | None, exposure: float | None) -> None:
    """Raise a :class:`UserError` for options that make no sense."""
    if ply is None and compact is None:
        raise UserError(
            "gpf export",
            "was not told what to write",
            "Add --ply OUT.ply or --compact OUT.safetensors.",
        )
    for option, target, suffix in (("ply", ply, ".ply"), ("compact", compact, ".safetensors")):
        if target is not None and target.suffix.lower() != suffix:
            raise UserError(
                f"--{option} {target}", f"does not end in {suffix}", "Give it a name that does."
            )
    if exposure is not None:
        if ply is None:
            raise UserError(f"--exposure {exposure}", "is for --ply alone", "Leave it out.")
        if not 0 < exposure < math.inf:
            raise UserError(f"--exposure {exposure}", "is no exposure", "Give one above zero.")


def find_field(field: str) -> Path:
    """The file of a field: a path, or the name of a scene that has been trained."""
    path = Path(field)
    if path.is_file():
        return path
    trained = {p.parent.name: p for p in sorted(RESULTS.glob("*/field.safetensors"))}
    if field in trained:
        return trained[field]
    if path.suffix or len(path.parts) > 1:
        raise UserError(field, "does not exist", "Check the path.")
    todo = suggest(field, list(trained), "There are fields of") if trained else ""
    raise UserError(
        field,
        f"is neither a file nor a scene with {RESULTS / field / 'field.safetensors'}",
        todo or f"Run `gpf stage train --scene {field}` first.",
    )


def read(source: Path) -> StoredField:
    """The field; whoever named another file need not delete it."""
    try:
        return read_field(source)
    except UserError as error:
        raise UserError(
            error.where, error.what, "Name a file that `gpf stage train` has written."
        ) from error


def known_exposure(source: Path, stored: StoredField) -> float:
    """That of the views beside the field; where there are none, one that suits the field."""
    views = source.parent / "views.yaml"
    return read_views(views).exposure if views.is_file() else propose_exposure(stored)


def tell(path: Path, what: str) -> None:
    """Say what has been written."""
    size = path.stat().st_size / 1e6
    say(f"{path}: {size:.1f} MB, {what}")
