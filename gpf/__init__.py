"""Gaussian Photon Fields: photon mapping whose result can be reused for every view.

Importing this package makes ``<integrator type="sppm">`` and ``<integrator type="gpf">``
available in Mitsuba 3, in whatever variant is or will be active. It never sets a variant.

The rooms, in the order in which data flows through them:

==========================  ==================================================================
:mod:`gpf.photon_tracing`   lights -> photons
:mod:`gpf.visible_points`   camera rays -> visible points (first diffuse hits)
:mod:`gpf.density`          photons and points -> irradiance
:mod:`gpf.initialization`   photons -> initial Gaussians
:mod:`gpf.training`         Gaussians and target irradiance -> fitted Gaussians
:mod:`gpf.field`            fitted Gaussians and points -> irradiance
:mod:`gpf.integrators`      all of it, as Mitsuba plugins
==========================  ==================================================================
"""

from gpf.runtime import ensure_llvm

# Dr.Jit reads the path of libLLVM once, when it is imported: this has to come first.
ensure_llvm()

from gpf.integrators import register_integrators  # noqa: E402

register_integrators()

__version__ = "0.1.0"
