"""Makes the system that options select; its module is imported only when needed."""

from __future__ import annotations

import importlib

from baselines.options import BaselineOptions
from baselines.protocol import Baseline


def make_baseline(options: BaselineOptions) -> Baseline:
    """The system that the options select.

    ``system: em_gmm`` is the class ``EmGmm`` in :mod:`baselines.em_gmm.baseline`; a system
    without a package, such as ``sppm``, is the class ``Sppm`` in :mod:`baselines.sppm`.
    """
    module = importlib.import_module(f"baselines.{options.system}")
    if hasattr(module, "__path__"):  # a package
        module = importlib.import_module(f"{module.__name__}.baseline")
    class_name = "".join(part.capitalize() for part in options.system.split("_"))
    system: Baseline = getattr(module, class_name)(options)
    return system
