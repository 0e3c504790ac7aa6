"""Measurements of speed and quality, each a program: `python -m benchmarks.NAME`.

Most of them time alternatives in turn in one process, so that other load affects all of them.
"""

import gpf  # noqa: F401  (before drjit is imported: gpf sets the path of libLLVM)
