"""`python -m benchmarks.pipeline COMMAND`: what `dvc repro` has left, measured in further ways."""

from __future__ import annotations

from benchmarks import cli
from benchmarks.judges import independent, truth

app = cli.make_app(truth, independent)

if __name__ == "__main__":
    cli.run(app)
