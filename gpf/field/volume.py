"""The field in media: fluence and mean direction of the light, blended from Gaussians in space."""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.recordable import Recordable
from gpf.core.structs import Haze, from_numpy
from gpf.field.field import GaussianPhotonField
from gpf.scene.media import Place


class VolumeField(Recordable):
    """Gaussians in media, with the first two moments of the radiance around them.

    Light is scattered as if a share r of it came from the mean direction and the rest from
    everywhere,

        ∫ f(ω, ω') L(ω') dω' = φ ((1 - r) / 4π + r f(ω, j)),    r = |J| / φ,    j = J / |J|:

    exact for beams, for isotropic phase functions, and for the mean cosine of all others.

    Parameters
    ----------
    fluence: a field whose colours are φ, W/m², without a normal test.
    moments: J, the mean of the channels of the radiance times its direction, W/m², (N, 3).
    lamps: whether the direct light of lamps is left out, so that it has to be sampled.
    """

    READ = ("fluence", "_moments")

    def __init__(self, fluence: GaussianPhotonField, moments: np.ndarray, lamps: bool) -> None:
        self.fluence, self.moments, self.lamps = fluence, moments, lamps
        colour = from_numpy(mi.Color3f, moments)
        gaussians = dataclasses.replace(fluence.gaussians, irradiance=colour)
        self._moments = GaussianPhotonField(
            gaussians, fluence.settings, fluence.bounds, detail=fluence.detail
        )

    def scattered(self, haze: Haze) -> mi.Color3f:
        """The light scattered towards the camera, W/(m² sr), (N, 3); 0 at invalid places."""
        n = mi.Normal3f(0, 0, 1)
        fluence = dr.maximum(self.fluence.query(haze.p, n, haze.valid)[0], 0)
        moment = mi.Vector3f(self._moments.query(haze.p, n, haze.valid)[0])
        length = dr.norm(moment)
        share = dr.clip(length / dr.maximum(dr.mean(fluence), 1e-20), 0, 1)
        place = Place(haze.p, moment / dr.maximum(length, 1e-20), haze.medium).interaction()
        context, active = mi.PhaseFunctionContext(), haze.valid & (length > 0)
        phase, _ = haze.medium.phase_function().eval_pdf(context, place, -haze.d, active)
        return fluence * dr.lerp(mi.Color3f(dr.inv_four_pi), phase, share)
