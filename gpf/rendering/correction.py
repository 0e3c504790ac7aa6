"""Corrects the picture of a field where gathered light shows that it is wrong.

Let F be the picture from a field, without noise. Let a and b be two pictures of the same view whose
light is gathered (:mod:`gpf.field.gathering`), with independent noise. What F lacks by them is

    A = (a - F) / F,    B = (b - F) / F.

A denoiser D takes most of the noise from these, and from their mean. The corrected picture is

    F (1 + w D((A + B) / 2)),    w = ⟨D(A) B + D(B) A⟩ / 2 / ⟨((D(A) + D(B)) / 2)²⟩,

with means over the pixels around each. The noise of D(A) is independent of B. So w is the factor
with the least squared error: about 1 where F is wrong, and about 0 where both halves show only
noise, or where the denoiser has smeared what was there. Near means alone would be fooled by lamps
that few rays find: where none has, both halves are too dark. So w is the smallest of those with
near means, with wide means, and with the means over the picture.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter

from gpf.rendering.denoiser import ImageDenoiser, median_lit

DARK = 0.01
"""Instead of smaller F, the formulas divide by this part of the median of the picture."""

MOST = 30.0
"""Largest A and B that the denoiser sees: single samples of lamps can be very bright."""

NEAR, WIDE = 8.0, 32.0
"""Standard deviations of the Gaussians with which means are taken, pixels."""

VISIBLE = 0.01
"""A picture that lacks less, as a root mean square of near means of A and B, needs no correction.
Two samples per pixel in each half found .006 or less in Cornell boxes and water, whose fields are
right, and .02 to .06 in rooms."""


def is_wrong(picture: np.ndarray, halves: np.ndarray) -> bool:
    """Whether a picture lacks light, or has too much, that shows and is more than noise; arguments
    as for :func:`corrected`.

    Few samples are enough: noise is in near means of one half only, so the mean of the products of
    both has none, but for a standard error. Products of two such means are as good as one in
    2π σ² pixels, σ being :data:`NEAR`.
    """
    near = gaussian_filter(_lacking(picture, halves), (0, NEAR, NEAR, 0))
    products = (near[0] * near[1]).mean(axis=2)
    error = products.std() * np.sqrt(2 * np.pi * NEAR**2 / products.size)
    return bool(products.mean() > max(VISIBLE**2, error))


def corrected(
    picture: np.ndarray, halves: np.ndarray, normal: np.ndarray, denoiser: ImageDenoiser
) -> np.ndarray:
    """The corrected picture, (H, W, 3).

    Parameters
    ----------
    picture: F, (H, W, 3).
    halves: the pictures a and b, (2, H, W, 3).
    normal: normals of the visible points, (H, W, 3), which guide the denoiser. Textures are in F,
        so it gets no albedo.
    """
    a, b = _lacking(picture, halves)

    def clean(lacking: np.ndarray, *guides: np.ndarray) -> np.ndarray:
        seen = np.clip(lacking, -1, MOST).astype(np.float32)
        return denoiser.denoise(1 + seen, *guides) - 1

    of_a = clean(a, np.ones_like(normal), normal)
    of_b, of_both = clean(b), clean((a + b) / 2)  # with the same guides
    agreed = (of_a * b + of_b * a).mean(axis=2) / 2
    square = (((of_a + of_b) / 2) ** 2).mean(axis=2)
    means: list[Callable[[np.ndarray], np.ndarray]] = [
        lambda values: gaussian_filter(values, NEAR),
        lambda values: gaussian_filter(values, WIDE),
        np.mean,
    ]
    shares = [mean(agreed) / np.maximum(mean(square), 1e-12) for mean in means]
    share = np.clip(np.minimum(np.minimum(shares[0], shares[1]), shares[2]), 0, 1)
    found: np.ndarray = picture + _unit(picture) * share[..., None] * of_both
    # Where the picture is black, the unit is larger than it is.
    return np.maximum(found, np.minimum(picture, 0))


def _lacking(picture: np.ndarray, halves: np.ndarray) -> np.ndarray:
    """A and B, (2, H, W, 3)."""
    lacking = (halves - picture) / _unit(picture)
    # What is not finite in the picture shows there; samples that are not finite tell nothing.
    return np.where(np.isfinite(lacking), lacking, 0)


def _unit(picture: np.ndarray) -> np.ndarray:
    """What A and B are divided by, (H, W, 3)."""
    unit: np.ndarray = np.maximum(picture, max(DARK * median_lit(picture), 1e-30))
    return unit
