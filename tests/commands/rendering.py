"""`gpf render` in a folder with the Cornell Box, `box.xml`."""

from __future__ import annotations

import pytest

from gpf.cli import main

CHEAP = ("--size", "20x16", "--spp", "4")


def render(*words: str) -> None:
    assert run(*CHEAP, *words) == 0


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as outcome:
        main(["render", "box.xml", *words])
    return outcome.value.code


def refused(capsys, *words: str) -> str:
    assert run(*CHEAP, *words) == 2
    return " ".join(capsys.readouterr().err.split())
