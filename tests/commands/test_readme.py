"""The commands of README.md under "Your own scene", in their order, with small numbers."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from gpf.cli import main
from gpf.viewing.viewer import Viewer
from tests.fuzz.good import SCENE
from tests.readme import blocks, commands
from tests.small_fit import make_small

SMALL = {"--seconds 120": "--passes 4", "--orbit 48": "--orbit 3", "--size 512x512": "--size 16x12"}


@pytest.fixture
def viewers(tmp_path, monkeypatch, two_threads):
    """In a folder with a scene; the pages that were served until Ctrl-C, which comes at once."""
    monkeypatch.chdir(tmp_path)
    Path("scene.xml").write_text(SCENE)
    make_small(monkeypatch, passes=4, steps=20, paths=5_000)
    monkeypatch.setattr("gpf.placement.cameras.ROWS", 32)
    monkeypatch.setattr("webbrowser.open", lambda address: None)
    served = []
    monkeypatch.setattr(Viewer, "run", lambda viewer: served.append(viewer))
    return served


@pytest.mark.slow
def test_the_commands_follow_each_other(viewers, capsys):
    (_, text), _, (language, code) = blocks("Your own scene")
    programs = []
    for program, *words in commands(text, SMALL):
        assert program == "gpf"
        with pytest.raises(SystemExit) as ended:
            main(words)
        assert not ended.value.code, capsys.readouterr().err
        programs.append(words[0])
    assert programs == ["fit", "render", "view"]
    assert len(list(Path("pictures").glob("*.exr"))) == 3 and Path("pictures/film.mp4").exists()
    assert len(viewers) == 1 and viewers[0].field is not None and viewers[0].fit is None
    assert "field.safetensors: a field of this scene; to fit a new one" in capsys.readouterr().err

    assert language == "python"
    scene = {"results/water_caustic/scene/scene.xml": "scene.xml", "llvm_ad_rgb": mi.variant()}
    for old, new in {**scene, "results/water_caustic/field": "field", "spp=64": "spp=4"}.items():
        assert old in code
        code = code.replace(old, new)
    names: dict = {}
    exec(code, names)
    image = np.array(names["image"])
    assert image.shape == (6, 8, 3) and np.isfinite(image).all() and image.mean() > 0.01
