"""Vectors of length 1."""

from __future__ import annotations

from typing import Any

import numpy as np


def normalise(vectors: Any) -> np.ndarray:
    """Vectors (..., D) scaled to length 1; zero stays zero, and infinity becomes NaN."""
    vectors = np.asarray(vectors)
    length = np.linalg.norm(vectors, axis=-1 if vectors.ndim > 1 else None, keepdims=True)
    with np.errstate(invalid="ignore"):
        return np.asarray(vectors / np.where(length > 0, length, 1))
