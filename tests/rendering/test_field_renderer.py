"""Views from a field."""

import mitsuba as mi

from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.bounds import scene_bounds
from gpf.scene.views import View
from tests.furnace import diffuse, floor
from tests.plain_field import flat_gaussians, to_device


def test_other_numbers_of_samples_than_squares_need_no_warning(capfd):
    scene = mi.load_dict({"type": "scene", "floor": floor(diffuse(0.5))})
    gaussians = to_device(flat_gaussians([[0, 0, 0]], [[1, 2, 3]]))
    field = GaussianPhotonField(gaussians, FieldSettings(search_radius=1.0), scene_bounds(scene))
    renderer = FieldRenderer.make(scene, field, RenderSettings(spp=32))
    view = View(name="it", origin=(0, 0, 5), target=(0, 0, 0), up=(0, 1, 0), fov=40)
    image = renderer.render(view, (8, 8), seed=1)["radiance"]
    assert image.any()
    assert "WARN" not in "".join(capfd.readouterr())
