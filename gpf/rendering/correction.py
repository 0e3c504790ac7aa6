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
    unit = np.maximum(picture, max(DARK * median_lit(picture), 1e-30))
    a, b = (halves - picture) / unit
    white = np.ones_like(normal)

    def clean(lacking: np.ndarray) -> np.ndarray:
        seen = np.clip(lacking, -1, MOST).astype(np.float32)
        return denoiser.denoise(1 + seen, white, normal) - 1

    of_a, of_b, of_both = clean(a), clean(b), clean((a + b) / 2)
    agreed = (of_a * b + of_b * a).mean(axis=2) / 2
    square = (((of_a + of_b) / 2) ** 2).mean(axis=2)
    means: list[Callable[[np.ndarray], np.ndarray]] = [
        lambda values: gaussian_filter(values, NEAR),
        lambda values: gaussian_filter(values, WIDE),
        np.mean,
    ]
    shares = [mean(agreed) / np.maximum(mean(square), 1e-12) for mean in means]
    share = np.clip(np.minimum(np.minimum(shares[0], shares[1]), shares[2]), 0, 1)
    found: np.ndarray = picture + unit * share[..., None] * of_both
    return found
