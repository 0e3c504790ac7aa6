"""The commands and the code that README.md shows."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

README = Path(__file__).parents[1] / "README.md"


def blocks(section: str) -> list[tuple[str, str]]:
    """Language ("" for commands) and text of the blocks of code in a section, in order."""
    text = README.read_text(encoding="utf-8")
    found = re.search(rf"^## {re.escape(section)}\n(.*?)(?=^## )", text, re.MULTILINE | re.DOTALL)
    assert found is not None, section
    return re.findall(r"^```(\w*)\n(.*?)^```$", found[1], re.MULTILINE | re.DOTALL)


def commands(text: str, instead: dict[str, str]) -> list[list[str]]:
    """The words of each line; comments are left out. Each key of ``instead`` has to be there once,
    and is replaced by its value."""
    for old, new in instead.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return [words for line in text.splitlines() if (words := shlex.split(line, comments=True))]
