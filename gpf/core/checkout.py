"""The project checkout that contains this package, if any."""

from pathlib import Path

_FOLDER = Path(__file__).resolve().parents[2]

CHECKOUT = _FOLDER if (_FOLDER / "stages" / "commands" / "benchmark.py").is_file() else None
"""Root of the checkout, or None if only the library is installed."""
