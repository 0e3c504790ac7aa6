"""From a row of params.yaml to its system, whose module is imported only now."""

from __future__ import annotations

import importlib

from gpf.baselines.options import BaselineOptions
from gpf.baselines.protocol import Baseline


def make_baseline(options: BaselineOptions) -> Baseline:
    """The system that the options are for.

    That of ``system: em_gmm`` is the class ``EmGmm`` of :mod:`gpf.baselines.em_gmm.baseline`; a
    system of one file has no folder.
    """
    module = importlib.import_module(f"gpf.baselines.{options.system}")
    if hasattr(module, "__path__"):  # a folder
        module = importlib.import_module(f"{module.__name__}.baseline")
    class_name = "".join(part.capitalize() for part in options.system.split("_"))
    system: Baseline = getattr(module, class_name)(options)
    return system
