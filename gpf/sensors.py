"""Views -> Mitsuba's sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gpf.views import View

if TYPE_CHECKING:
    import mitsuba as mi


def make_sensor(
    view: View, width: int, height: int, spp: int = 16, sampler: str = "independent"
) -> mi.Sensor:
    """A Mitsuba perspective sensor for a view: RGB float32 film, box filter.

    The box filter makes a pixel the plain mean of its own samples, for every method alike.
    """
    import mitsuba as mi

    look_at = mi.ScalarTransform4f().look_at(
        origin=list(view.origin), target=list(view.target), up=list(view.up)
    )
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": view.fov,
            "fov_axis": view.fov_axis,
            "near_clip": 1e-3,
            "far_clip": 1e5,
            "to_world": look_at,
            "sampler": {"type": sampler, "sample_count": spp},
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
        }
    )
