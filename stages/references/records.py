"""What made a reference: the record in its file that tells whether it is still current."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.core.errors import UserError
from gpf.core.files import read_tensors
from gpf.core.images import read_record
from gpf.scene.views import View
from gpf.sppm.passes import PassSettings
from stages.common.code import digest_of
from stages.common.workspace import Workspace


def group_record(
    work: Workspace, group: str, settings: PassSettings, seed: int, share: float, imaged: list[str]
) -> dict[str, Any]:
    """What all views of a group have in common, as JSON values."""
    section = work.params.reference
    return {
        "group": group,
        "passes": section.passes,
        "target_psnr": section.target_psnr,
        "code": digest_of("reference"),
        "made_with": [mi.variant(), mi.__version__, dr.__version__],
        "scene": work.scene_digest,
        "size": list(work.film_size),
        "visible_region": work.params.visible_region.model_dump(),
        "share": share,
        "imaged": imaged,
        **settings.model_dump(),
        "seed": seed,
    }


def view_record(record: dict[str, Any], view: View) -> dict[str, Any]:
    """What made a view's file; a view does not depend on which others have images."""
    imaged = view.name in record["imaged"]
    return {**record, "imaged": imaged, "view": view.model_dump(mode="json")}


def surface_record(work: Workspace, record: dict[str, Any]) -> dict[str, Any]:
    """What made the samples of the surfaces: they lie where the training views look."""
    apart = {key: value for key, value in record.items() if key not in ("share", "imaged")}
    views = [view.model_dump(mode="json") for view in work.views.train]
    return {**apart, "views": views, "surface_points": work.params.reference.surface_points}


def is_current(work: Workspace, group: str, view: View, record: dict[str, Any]) -> bool:
    """Whether a view's file is what the record asks for."""
    path = (
        work.second_reference(view.name)
        if group == "second_reference"
        else work.reference(view.name)
    )
    found = read_record(path)
    if found is None:
        return False
    needed = view_record(record, view)
    if found.get("imaged") is True:  # an image that nobody needs does no harm
        needed.pop("imaged")
    return found.items() >= needed.items()


def passes_done(work: Workspace, group: str, views: Sequence[View]) -> int:
    """How many passes the files of a group's views have: fewer than asked for, where fewer did."""
    paths = [
        work.second_reference(v.name) if group == "second_reference" else work.reference(v.name)
        for v in views
    ]
    records = [record for path in paths if (record := read_record(path)) is not None]
    done = [record["passes_done"] for record in records if "passes_done" in record]
    return min(done, default=work.params.reference.passes)


def has_surfaces(work: Workspace, record: dict[str, Any]) -> bool:
    """Whether the file of surface samples is what the record asks for."""
    if not work.surfaces.exists():
        return False
    try:
        _, metadata = read_tensors(work.surfaces, "surfaces")
    except UserError:
        return False
    return metadata == surface_record(work, record)
