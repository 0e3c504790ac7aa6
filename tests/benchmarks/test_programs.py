"""The programs in `benchmarks/` start, and describe themselves."""

from __future__ import annotations

import runpy
import sys

import pytest


@pytest.mark.parametrize("name", ["", "gpu", "pipeline", "processes", "quality", "scenes"])
def test_each_program_describes_itself(name, monkeypatch, capfd):
    module = f"benchmarks.{name}" if name else "benchmarks"
    monkeypatch.setattr(sys, "argv", [module, "--help"])
    # Other tests import these programs.
    monkeypatch.delitem(sys.modules, module if name else "benchmarks.__main__", raising=False)
    with pytest.raises(SystemExit) as outcome:
        runpy.run_module(module, run_name="__main__")
    assert outcome.value.code in (None, 0)
    assert "Usage" in capfd.readouterr().out
