"""The field in media: fluence and directions of the light, blended from Gaussians in space."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.recordable import Recordable
from gpf.core.structs import Haze
from gpf.field.field import GaussianPhotonField
from gpf.scene.light_groups import Levels
from gpf.scene.phase_functions import scatter_lobes


class VolumeField(Recordable):
    """Gaussians in media, with the first two moments of the radiance around them: of the light that
    nothing has scattered yet, such as a caustic's, and of the rest.

    In each channel, the light of either kind is taken for a lobe of Henyey and Greenstein's shape
    about its mean direction j, as wide as its mean cosine r says. Such a lobe, scattered by such a
    phase function, is one again, and their mean cosines are multiplied:

        ∫ f_g(ω, ω') L(ω') dω' = φ f_gr(ω, j),    r = |J| / φ,    j = J / |J|.

    This is exact for beams, for isotropic phase functions, and for the mean cosine in all cases.

    Parameters
    ----------
    fluence: a field whose colours are φ, W/m², without a normal test.
    moments: J and φ, W/m², for both kinds of light and each channel, (N, 2, 3, 4). Only the ratios
        of a channel's values count.
    light_moments: those of each group of emitters, (G, N, 2, 3, 4), if the fluence keeps groups
        apart.
    """

    READ = ("fluence",)

    def __init__(
        self,
        fluence: GaussianPhotonField,
        moments: np.ndarray,
        light_moments: np.ndarray | None = None,
    ) -> None:
        self.fluence, self.moments, self.light_moments = fluence, moments, light_moments
        self._set_moments(moments)

    def _set_moments(self, moments: np.ndarray) -> None:
        self.fluence.set_vectors(moments.reshape(len(moments), -1, 4))

    def set_levels(self, levels: Levels) -> None:
        """Set the levels of groups of emitters, which the field keeps apart."""
        lights = self.fluence.lights
        assert lights is not None and self.light_moments is not None
        total = np.zeros_like(self.moments)
        for name, moments in zip(lights.groups.names, self.light_moments, strict=True):
            level = np.array(levels.get(name, (1.0, 1.0, 1.0)), np.float32)
            total += level[:, None] * moments
        self.fluence.recolour(lights.at(levels))
        self._set_moments(total)

    def scattered(self, haze: Haze) -> mi.Color3f:
        """The light scattered towards the camera, W/(m² sr), (N, 3); 0 at invalid places."""
        fluence, share = self._scatter(haze)
        return fluence * share

    def error(self, haze: Haze) -> mi.Color3f:
        """The expected error of :meth:`scattered`, W/(m² sr), (N, 3)."""
        n = mi.Normal3f(0, 0, 1)
        return self.fluence.part("error").query(haze.p, n, haze.valid)[0] * self._scatter(haze)[1]

    def _scatter(self, haze: Haze) -> tuple[mi.Color3f, mi.Color3f]:
        """Fluence, and the part of it that is scattered towards the camera, 1/sr, (N, 3) each."""
        values, _ = self.fluence.query_all(haze.p, mi.Normal3f(0, 0, 1), haze.valid)
        fluence, lobes = dr.maximum(values[0], 0), [_Lobe(haze, m) for m in values[1:]]
        means, cosines = [lobe.mean for lobe in lobes], [lobe.cosine for lobe in lobes]
        shares, found = scatter_lobes(haze.medium, means, cosines), mi.Color3f(0)
        for k in range(3):  # of the channel: light that nothing has scattered, and the rest
            first, second = lobes[k].fluence, lobes[3 + k].fluence
            turned = first * shares[k] + second * shares[3 + k]
            found[k] = dr.select(fluence[k] > 0, turned / (first + second), 0)
        return fluence, found


class _Lobe:
    """Light of one kind in one channel: its fluence, its mean cosine, and the cosine of the angle
    between its direction and the way to the camera, (N,) each."""

    def __init__(self, haze: Haze, moment: mi.Vector4f) -> None:
        vector = mi.Vector3f(moment.x, moment.y, moment.z)
        length = dr.norm(vector)
        self.fluence = dr.maximum(dr.maximum(moment.w, length), 1e-30)
        self.mean = length / self.fluence
        self.cosine = -dr.dot(vector, haze.d) / dr.maximum(length, 1e-30)
