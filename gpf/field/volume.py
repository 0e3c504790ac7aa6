"""The field in media: fluence and mean direction of the light, blended from Gaussians in space."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.recordable import Recordable
from gpf.core.structs import Haze
from gpf.field.field import GaussianPhotonField
from gpf.scene.light_groups import Levels
from gpf.scene.media import Place


class VolumeField(Recordable):
    """Gaussians in media, with the first two moments of the radiance around them.

    Light is scattered as if, in each channel, a share r of it came from the mean direction and the
    rest from everywhere,

        ∫ f(ω, ω') L(ω') dω' = φ ((1 - r) / 4π + r f(ω, j)),    r = |J| / φ,    j = J / |J|:

    exact for beams, for isotropic phase functions, and for the mean cosine of all others.

    Parameters
    ----------
    fluence: a field whose colours are φ, W/m², without a normal test.
    moments: J of each channel, W/m², (N, 3, 3).
    light_moments: those of each group of emitters, (G, N, 3, 3), if the fluence keeps groups apart.
    """

    READ = ("fluence",)

    def __init__(
        self,
        fluence: GaussianPhotonField,
        moments: np.ndarray,
        light_moments: np.ndarray | None = None,
    ) -> None:
        self.fluence, self.moments, self.light_moments = fluence, moments, light_moments
        fluence.set_vectors(moments)

    def set_levels(self, levels: Levels) -> None:
        """Set the levels of groups of emitters, which the field keeps apart."""
        lights = self.fluence.lights
        assert lights is not None and self.light_moments is not None
        total = np.zeros_like(self.moments)
        for name, moments in zip(lights.groups.names, self.light_moments, strict=True):
            level = np.array(levels.get(name, (1.0, 1.0, 1.0)), np.float32)
            total += level[:, None] * moments
        self.fluence.recolour(lights.at(levels))
        self.fluence.set_vectors(total)

    def scattered(self, haze: Haze) -> mi.Color3f:
        """The light scattered towards the camera, W/(m² sr), (N, 3); 0 at invalid places."""
        fluence, share = self._scatter(haze)
        return fluence * share

    def error(self, haze: Haze) -> mi.Color3f:
        """The expected error of :meth:`scattered`, W/(m² sr), (N, 3)."""
        n = mi.Normal3f(0, 0, 1)
        return self.fluence.query_error(haze.p, n, haze.valid) * self._scatter(haze)[1]

    def _scatter(self, haze: Haze) -> tuple[mi.Color3f, mi.Color3f]:
        """Fluence, and the part of it that is scattered towards the camera, 1/sr, (N, 3) each."""
        (fluence, *moments), _ = self.fluence.query_all(haze.p, mi.Normal3f(0, 0, 1), haze.valid)
        fluence = dr.maximum(fluence, 0)
        context, phase = mi.PhaseFunctionContext(), haze.medium.phase_function()
        found = mi.Color3f(0)
        for k, moment in enumerate(moments):
            length = dr.norm(moment)
            share = dr.clip(length / dr.maximum(fluence[k], 1e-20), 0, 1)
            place = Place(haze.p, moment / dr.maximum(length, 1e-20), haze.medium).interaction()
            turned, _ = phase.eval_pdf(context, place, -haze.d, haze.valid & (length > 0))
            found[k] = dr.lerp(dr.inv_four_pi, turned[k], share)
        return fluence, found
