"""Gaussian Photon Fields: photon mapping whose result can be reused for every view.

Importing this package makes ``<integrator type="sppm">`` and ``<integrator type="gpf">``
available in Mitsuba 3, in whatever variant is or will be active. It never sets a variant.

The rooms, in the order in which data flows through them:

==========================  ==================================================================
:mod:`gpf.photons.tracing`   lights -> photons
:mod:`gpf.camera.visible_points`   camera rays -> visible points (first diffuse hits)
:mod:`gpf.sppm.density`          photons and points -> irradiance
:mod:`gpf.field.initialization`   photons -> initial Gaussians
:mod:`gpf.training.trainer`         Gaussians and target irradiance -> fitted Gaussians
:mod:`gpf.field.field`            fitted Gaussians and points -> irradiance
:mod:`gpf.rendering.plugins`      all of it, as Mitsuba plugins
==========================  ==================================================================
"""

from gpf.core.runtime import ensure_llvm

# Dr.Jit reads the path of libLLVM once, when it is imported: this has to come first.
ensure_llvm()

from gpf.rendering.plugins import register_integrators  # noqa: E402

register_integrators()

__version__ = "0.1.0"
