"""Measurements of speed and quality.

- `python -m benchmarks`: speed as ratios, measured in one process; what `make bench` runs.
- `python -m benchmarks.gpu`: whether everything works on a GPU; what `make gpu` runs.
- `python -m benchmarks.processes`: time and memory of whole processes, `gpf view` among them.
- `python -m benchmarks.quality`: fields against SPPM and path tracing.
- `python -m benchmarks.pipeline`: what `dvc repro` has left, measured in further ways.
- `python -m benchmarks.scenes`: cameras around any scene, and scenes made by others.

Each but the first two has several commands; `--help` lists them and their options.
"""

import gpf  # noqa: F401  (before drjit is imported: gpf sets the path of libLLVM)
