"""Code that kills its process, or hangs, leaves this one alive, with its last words."""

import pytest

from gpf.core import subprocesses


def test_an_abort_is_survived_and_told_by_its_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = 'print(\'{"llvm": [19, 1, 0], "cuda": false}\', flush=True)'
    monkeypatch.setattr(subprocesses, "PROBE", f"import os\n{answer}\nos.abort()")
    assert subprocesses.run_probe() == {"llvm": [19, 1, 0], "cuda": False, "died": "signal 6"}


def test_the_last_words_of_a_failed_probe_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocesses, "PROBE", "raise OSError('no library')")
    assert subprocesses.run_probe() == {"died": "OSError: no library"}
    assert subprocesses.last_line("") == "no message"


def test_a_probe_that_hangs_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocesses, "TIMEOUT", 0.5)
    code = "import time; print('so far', flush=True); time.sleep(60)"
    assert subprocesses.run_python(code) == (1, "so far\n", "no answer within 0.5 seconds")
