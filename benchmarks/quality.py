"""`python -m benchmarks.quality COMMAND`: fields against SPPM and path tracing."""

from __future__ import annotations

from benchmarks import cli
from benchmarks.energy import energy
from benchmarks.error import error
from benchmarks.fit import fit, frame
from benchmarks.frames import frames
from benchmarks.inverse import inverse
from benchmarks.noise import noise
from benchmarks.rooms import rooms

app = cli.make_app(fit, frame, frames, error, energy, rooms, noise, inverse)

if __name__ == "__main__":
    cli.run(app)
