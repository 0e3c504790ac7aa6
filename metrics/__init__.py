"""Numbers about images and about cost: what an image is worth and what it took.

Nothing here knows the renderer: images are arrays, times are seconds. Errors
that a caller can cause are ``ValueError``; a metric that cannot be computed on
this machine is a ``MetricUnavailable``, whose words say what brings it.
"""

from metrics.cost import CostLine, break_even, cumulative
from metrics.equivalent_passes import EquivalentPasses, equivalent_passes
from metrics.errors import MetricUnavailable
from metrics.image import Comparison, compare, expose, flip_exposures, psnr, unavailable

__all__ = [
    "Comparison",
    "CostLine",
    "EquivalentPasses",
    "MetricUnavailable",
    "Worth",
    "break_even",
    "compare",
    "cumulative",
    "equivalent_passes",
    "expose",
    "flip_exposures",
    "psnr",
    "unavailable",
]
