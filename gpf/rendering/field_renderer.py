"""Renders views from a field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.images import check_finite
from gpf.core.random import Stream, pass_seed
from gpf.field.field import GaussianPhotonField
from gpf.rendering.aovs import split_layers
from gpf.rendering.settings import RenderSettings
from gpf.rendering.timed_sampling import sample_for
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View

# Light is weakly covered if the farthest Gaussian of its query is this many search radii away.
# Where a field has learned, there are enough within one; in a closed box beside that, the light
# outside was found at 1.04 to 1.4.
WEAK_COVERAGE = 1.1

OF_FIELD = 0.3
"""The part of a picture's time for samples of the field, if others correct them."""

REST = 64
"""The number of the first part of further samples, if nothing is to be corrected."""


@dataclass(frozen=True)
class FieldRenderer:
    """A scene with its field; renders any view.

    Attributes
    ----------
    integrator: the plugin ``gpf``.
    aovs: names of the layers besides radiance (:mod:`gpf.rendering.aovs`).
    """

    scene: mi.Scene
    integrator: Any
    settings: RenderSettings
    aovs: tuple[str, ...] = ()

    @classmethod
    def make(
        cls,
        scene: mi.Scene,
        field: GaussianPhotonField,
        settings: RenderSettings,
        aovs: Sequence[str] = (),
    ) -> FieldRenderer:
        """Make the integrator for a field.

        Raises
        ------
        UserError: light is to be gathered, but the field does not know its caustics.
        """
        if settings.gather == "always" and field.caustics is None:
            raise UserError(
                "gather",
                "is always, but the field does not know which part of its light is caustics",
                "Fit it again with `gpf fit`. Light cannot be gathered where there are media, or "
                "while lamps have other levels than in the scene.",
            )
        integrator = mi.load_dict(
            {
                "type": "gpf",
                "rr_depth": settings.rr_depth,
                "adaptive": settings.adaptive,
                "suppress_fireflies": settings.suppress_fireflies,
                "denoise": settings.denoise,
                "gather": settings.gather,
                "aovs": ",".join(aovs),
            }
        )
        integrator.field = field
        return cls(scene, integrator, settings, tuple(aovs))

    def render(
        self, view: View, size: tuple[int, int], seed: int, seconds: float | None = None
    ) -> dict[str, np.ndarray]:
        """The layers of a view: ``radiance``, W/(m² sr), (H, W, 3), and the AOVs.

        Parameters
        ----------
        size: width and height, pixels.
        seconds: take as many samples as fit into this time, with gathered light for most of it if
            that corrects the picture; by default, as many as the settings say.

        Raises
        ------
        UserError: a pixel is not finite.
        """
        settings, integrator = self.settings, self.integrator
        sensor = make_sensor(view, *size, sampler=settings.sampler)
        known: list[tuple[int, np.ndarray]] = []

        def sample(spp: int, seed: int) -> np.ndarray:
            image, variance = integrator.sample_image(self.scene, sensor, seed, spp)
            if variance is not None:
                known.append((spp, variance))
            return np.array(image)

        def sample_part(spp: int, part: int, first: int = 0) -> np.ndarray:
            return sample(spp, pass_seed(seed, first + part, Stream.TIMED_SAMPLES))

        def correct(picture: np.ndarray) -> np.ndarray | None:
            rest = seconds and seconds * (1 - OF_FIELD)
            found: np.ndarray | None = integrator.gathered_for(
                self.scene, sensor, seed, spp, picture, rest
            )
            corrected.append(found is not None)
            return found

        corrects, corrected = integrator.corrects(sensor), [False]
        if seconds is None:
            image, spp = sample(settings.spp, seed), settings.spp
        else:
            image, spp = sample_for(seconds * (OF_FIELD if corrects else 1), sample_part)
        if settings.denoise:
            variance = variance_of_mean(known, spp)
            clean = integrator.denoised(image, variance, correct if corrects else None)
            if seconds and corrects and not corrected[-1]:
                rest = partial(sample_part, first=REST)
                more, count = sample_for(seconds * (1 - OF_FIELD), rest)
                image, spp = image + (more - image) * np.float32(count / (spp + count)), spp + count
                clean = integrator.denoised(image, variance_of_mean(known, spp))
            image = clean
        layers = split_layers(image, self.aovs)
        check_finite(layers["radiance"], f"view {view.name}")
        return layers


def variance_of_mean(known: Sequence[tuple[int, np.ndarray]], spp: int) -> np.ndarray | None:
    """The variance of an image's pixels, (H, W), from those of parts of it with their numbers of
    samples; ``spp``: those of the image. Parts that are not known count as noisy as the others."""
    if not known:
        return None
    whole = spp * sum(n for n, _ in known)
    return np.sum([n * n / whole * variance for n, variance in known], axis=0)


def weakly_covered(coverage: np.ndarray) -> float:
    """The share of weakly covered pixels, from the AOV ``coverage``."""
    return float(np.mean(coverage > WEAK_COVERAGE))


def describe_coverage(shares: Mapping[str, float]) -> str:
    """Describe the shares of weakly covered pixels, given by the name of the view."""
    worst = max(shares, key=shares.__getitem__)
    mean = sum(shares.values()) / len(shares)
    return (
        f"{mean:.2%} of the pixels are weakly covered by Gaussians (channel coverage above "
        f"{WEAK_COVERAGE:g}): they got the light of their surroundings, even through walls; in the "
        f"worst view, {worst}, {shares[worst]:.2%}"
    )
