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
:mod:`gpf.sppm`         photons and points -> irradiance
:mod:`gpf.field`        photons -> initial Gaussians; Gaussians and points -> irradiance
:mod:`gpf.training`     Gaussians and target irradiance -> fitted Gaussians
:mod:`gpf.rendering`    the integrators ``sppm`` and ``gpf``
:mod:`gpf.baking`       a field and the surfaces of a scene -> light maps, light at vertices
:mod:`gpf.blender`      files that Blender reads -> scenes of Mitsuba
:mod:`gpf.placement`    a scene and its own camera -> cameras around it
:mod:`gpf.fitting`      a scene and cameras -> a field and an estimate of its quality
:mod:`gpf.commands`     the commands ``gpf fit``, ``gpf render`` and ``gpf demo``
:mod:`gpf.modelling`    meshes and textures for generated scenes
======================  =========================================================================
"""

import lazy_loader

from gpf.core.runtime import ensure_llvm

# Dr.Jit reads the path of libLLVM once, when it is imported, so this must run first.
ensure_llvm()

from gpf.rendering.plugins import register_plugins  # noqa: E402

register_plugins()

__version__ = "0.2.0"

# `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
