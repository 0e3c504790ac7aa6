"""What a worker makes shorter, so that a case takes a part of a second: sizes and waiting.

What is checked stays as it is.
"""

from __future__ import annotations

import webbrowser
from functools import partial
from typing import Any

import pytest

from tests.small_fit import make_small


def take() -> None:
    """Change this process."""
    from gpf.importing import importer
    from gpf.viewing import viewer
    from stages.commands import scene_import
    from tests.importing.foreign_scene import place_two

    few = partial(importer.import_scene, photons=500)
    scene_import.import_scene = few  # type: ignore[assignment]
    scene_import.place_views = place_two
    # A page that is served until Ctrl-C: it starts, and that is all.
    viewer.Viewer.run = _return  # type: ignore[method-assign]
    webbrowser.open = _return  # type: ignore[assignment]
    make_small(pytest.MonkeyPatch(), passes=2, steps=4, paths=2000)


def _return(*_: Any, **__: Any) -> bool:
    return True
