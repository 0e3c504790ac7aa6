"""The checkout of the project that this package lies in, if it lies in one."""

from pathlib import Path

_FOLDER = Path(__file__).resolve().parents[2]

CHECKOUT = _FOLDER if (_FOLDER / "stages" / "commands" / "benchmark.py").is_file() else None
"""Its root; None where only the library is installed."""
