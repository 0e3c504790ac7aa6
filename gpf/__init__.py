"""Gaussian Photon Fields: photon mapping whose result is a reusable field of Gaussians.

Importing this package registers the integrators ``sppm`` and ``gpf`` in Mitsuba 3, for the active
variant and for every variant that is set later. It never sets a variant itself. The public names,
``gpf.__all__``, are loaded on first use.

The packages, each of which imports only from those above it:

======================  =========================================================================
:mod:`gpf.core`         errors, files, settings, random numbers, neighbour search
:mod:`gpf.scene`        scene files, views, sensors, materials, bounds
:mod:`gpf.photons`      emitters -> photons
:mod:`gpf.camera`       camera rays -> visible points (first diffuse hits)
:mod:`gpf.guiding`      emission plan: the visible region, and more photons towards it
:mod:`gpf.sppm`         photons and points -> irradiance; references
:mod:`gpf.field`        photons -> initial Gaussians; Gaussians and points -> irradiance
:mod:`gpf.training`     Gaussians and target irradiance -> fitted Gaussians
:mod:`gpf.rendering`    the integrators ``sppm`` and ``gpf``
:mod:`gpf.importing`    other people's Mitsuba scenes -> scenes with views
:mod:`gpf.fitting`      a scene and cameras -> a field and an estimate of its quality
:mod:`gpf.commands`     the commands ``gpf fit``, ``gpf render`` and ``gpf demo``
:mod:`gpf.modelling`    meshes and textures for generated scenes
======================  =========================================================================
"""

import importlib
from typing import TYPE_CHECKING, Any

from gpf.core.runtime import ensure_llvm

# Dr.Jit reads the path of libLLVM once, when it is imported, so this must run first.
ensure_llvm()

from gpf.rendering.plugins import register_plugins  # noqa: E402

register_plugins()

__version__ = "0.2.0"

# Public name -> module. Type checkers read the imports below instead.
_MODULES = {
    "EmissionPlan": "gpf.guiding.emission_plan",
    "FieldSettings": "gpf.field.settings",
    "FileError": "gpf.core.errors",
    "GaussianPhotonField": "gpf.field.field",
    "PassSettings": "gpf.sppm.passes",
    "PathSettings": "gpf.photons.tracing",
    "Photons": "gpf.core.structs",
    "ReferenceRenderer": "gpf.sppm.reference",
    "ReferenceSettings": "gpf.sppm.reference",
    "RenderSettings": "gpf.rendering.settings",
    "SceneViews": "gpf.scene.views",
    "StreamSettings": "gpf.training.streaming",
    "TrainingSettings": "gpf.training.settings",
    "UserError": "gpf.core.errors",
    "View": "gpf.scene.views",
    "VisibleRegionSettings": "gpf.guiding.emission_plan",
    "choose_variant": "gpf.core.runtime",
    "fit": "gpf.fitting.fit",
    "load_field": "gpf.field.io",
    "load_scene_file": "gpf.scene.load",
    "make_sensor": "gpf.scene.sensors",
    "read_views": "gpf.scene.views",
    "save_field": "gpf.field.io",
}
__all__ = list(_MODULES)

if TYPE_CHECKING:
    from gpf.core.errors import FileError as FileError
    from gpf.core.errors import UserError as UserError
    from gpf.core.runtime import choose_variant as choose_variant
    from gpf.core.structs import Photons as Photons
    from gpf.field.field import GaussianPhotonField as GaussianPhotonField
    from gpf.field.io import load_field as load_field
    from gpf.field.io import save_field as save_field
    from gpf.field.settings import FieldSettings as FieldSettings
    from gpf.fitting.fit import fit as fit
    from gpf.guiding.emission_plan import EmissionPlan as EmissionPlan
    from gpf.guiding.emission_plan import VisibleRegionSettings as VisibleRegionSettings
    from gpf.photons.tracing import PathSettings as PathSettings
    from gpf.rendering.settings import RenderSettings as RenderSettings
    from gpf.scene.load import load_scene_file as load_scene_file
    from gpf.scene.sensors import make_sensor as make_sensor
    from gpf.scene.views import SceneViews as SceneViews
    from gpf.scene.views import View as View
    from gpf.scene.views import read_views as read_views
    from gpf.sppm.passes import PassSettings as PassSettings
    from gpf.sppm.reference import ReferenceRenderer as ReferenceRenderer
    from gpf.sppm.reference import ReferenceSettings as ReferenceSettings
    from gpf.training.settings import TrainingSettings as TrainingSettings
    from gpf.training.streaming import StreamSettings as StreamSettings
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = globals()[name] = getattr(importlib.import_module(_MODULES[name]), name)
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
