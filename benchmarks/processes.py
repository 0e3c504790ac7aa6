"""`python -m benchmarks.processes COMMAND`: time and memory of whole processes."""

from __future__ import annotations

from benchmarks import cli
from benchmarks.growth import growth, memory
from benchmarks.start import start
from benchmarks.viewer import viewer

app = cli.make_app(growth, memory, start, viewer)

if __name__ == "__main__":
    cli.run(app)
