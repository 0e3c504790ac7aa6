"""Somebody else's scene in a folder, and a scenes folder to import it into."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def original(tmp_path) -> Path:
    """A folder with a scene in it, as somebody else would have made it."""
    # Mitsuba comes with it, and this file may be read before a variant is set.
    from tests.stages.importing.foreign_scene import write_original

    return write_original(tmp_path / "Their Room")


@pytest.fixture
def root(tmp_path) -> Path:
    """A scenes folder in which nothing is yet."""
    root = tmp_path / "project/scenes"
    root.mkdir(parents=True)
    return root
