"""README.md's commands for the pipeline with one's own scene."""

from __future__ import annotations

import pytest

from stages.config.params import read_params
from tests.readme import blocks, commands
from tests.stages.importing.foreign_scene import pack, write_original
from tests.stages.pipeline import Checkout

pytest.importorskip("dvc")
pytestmark = pytest.mark.slow


def test_an_imported_scene_is_in_the_pipeline(fresh, environment, tmp_path):
    (tmp_path / "scenes").mkdir()
    pack(write_original(tmp_path / "kitchen"), tmp_path / "scenes/kitchen.zip")
    checkout = Checkout.make(fresh, tmp_path / "bin", environment(HOME=str(tmp_path)))
    _, (language, text), _ = blocks("Your own scene")
    assert language == ""
    # The whole pipeline takes minutes: of the new scene, its first stage is enough.
    first, second = commands(text, {"dvc repro ": "dvc repro scene@kitchen "})
    assert (first[:3], second[:2]) == (["gpf", "scene", "import"], ["dvc", "repro"])
    checkout.call("sh", "-c", " ".join(first))
    assert read_params(fresh.folder / "params.yaml").scenes == ("cornell_box", "kitchen")
    assert "Running stage 'scene@kitchen'" in checkout.dvc(*second[1:])
    assert (fresh.folder / "results/kitchen/scene/scene.xml").exists()
    everything = checkout.dvc("stage", "list", "--name-only").split()
    assert {f"{stage}@kitchen" for stage in ("reference", "train", "amortize")} <= {*everything}
