"""The way to RenderFormer and back, with a stand-in for its network; and with the network itself
where the published code is installed, small and with random weights."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from baselines.options import RenderFormerOptions
from baselines.protocol import CannotServe
from baselines.renderformer.baseline import CODE, Renderformer, crop, supersampling
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.baselines.adapters import STAND_INS, make_task, write_weights
from tests.furnace import diffuse, floor, lamp, rectangle

SIZE = (9, 6)
VIEW = View(name="a", origin=(0.2, -3, 1), target=(0, 0.3, 0.9), up=(0, 0, 1), fov=55, fov_axis="y")

# Triangles, for the stand-in to be fast.
FEW = {"triangles": 24}

# The published network, as small as it gets.
TINY = """
import sys
import torch
from renderformer import RenderFormer
from renderformer.models.config import RenderFormerConfig

torch.manual_seed(0)
config = RenderFormerConfig(
    latent_dim=36, num_layers=1, num_heads=1, dim_feedforward=36, num_register_tokens=2,
    vertex_pe_num_freqs=4, vn_pe_num_freqs=2, view_transformer_latent_dim=36,
    view_transformer_ffn_hidden_dim=36, view_transformer_n_heads=1, view_transformer_n_layers=4,
    dpt_features=4, dpt_out_channels=[4, 4, 4, 4],
)
model = RenderFormer(config)
model.save_pretrained(sys.argv[1])
"""


def lit_room(**more: Any) -> dict[str, Any]:
    """Two surfaces that do not shade each other, and lamps of two colours; one lamp is in view."""
    return {
        "type": "scene",
        "floor": floor(diffuse(0.6, 0.5, 0.2), size=3),
        "wall": rectangle((0, 1.2, 1), (0, 0, 1), 3, 2, diffuse(0.2, 0.3, 0.7)),
        "warm": lamp((0.4, 0.5, 2.4), (0.2, -1.5, 0.4), 0.3, 50, 40, 20),
        "cold": lamp((-0.8, -1.2, 2.5), (0, 0.4, 0.3), 0.2, 10, 30, 60),
    } | more


@pytest.fixture
def scene_files(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """h5py, or what stands for it."""
    if importlib.util.find_spec("h5py") is not None:
        yield
        return
    folder = str(STAND_INS / "h5py")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", folder, prepend=os.pathsep)
    yield
    sys.modules.pop("h5py", None)


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch, scene_files: None) -> None:
    monkeypatch.setenv(CODE.variable, str(STAND_INS / "renderformer"))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # threads that wait for each other make it slow


def look(view: View) -> np.ndarray:
    """The light of the lamps as Mitsuba sees it, without any that came by two surfaces."""
    scene = mi.load_dict(lit_room() | {"integrator": {"type": "path", "max_depth": 2}})
    return mi.render(scene, sensor=make_sensor(view, *SIZE), spp=4096, seed=1).numpy()


def prepare(state: Path, weights: str, scene: dict[str, Any] | None = None, **more: Any) -> Any:
    options = RenderFormerOptions(system="renderformer", weights=weights, **more)
    loaded = mi.load_dict(scene or lit_room(), optimize=False)  # as scene files are
    return Renderformer(options).prepare(make_task(state, loaded, SIZE))


@pytest.mark.usefixtures("stand_in")
def test_light_comes_back_in_the_scenes_own_units(tmp_path: Path) -> None:
    prepared = prepare(tmp_path, write_weights(tmp_path / "weights", {"gain": [0.5]}), **FEW)
    image = prepared.render(VIEW, 1)
    again = prepared.render(VIEW, 2)
    other = prepared.render(VIEW.model_copy(update={"fov": 20.0}), 1)

    expected = look(VIEW) / 2  # what the gain stands for
    assert image.shape == (6, 9, 3) and image.dtype == np.float32
    bright = expected.max(axis=2) > 0.5  # the lamp, which pixels see a part of
    assert 1 <= bright.sum() <= 4 and (expected.max(axis=2) == 0).any()
    np.testing.assert_allclose(image[~bright], expected[~bright], rtol=0.03, atol=0.003)
    np.testing.assert_allclose(image[bright], expected[bright], rtol=0.08)
    np.testing.assert_array_equal(image, again)
    plain = look(VIEW.model_copy(update={"fov": 20.0})) / 2
    np.testing.assert_allclose(np.median(other / np.maximum(plain, 1e-3)), 1, rtol=0.02)

    facts = prepared.facts
    assert prepared.storage_bytes == 0 and facts["device"] in ("cpu", "cuda")
    assert facts["triangles"] == 24 and facts["network_seconds"] > 0


@pytest.mark.usefixtures("stand_in")
def test_weights_that_are_not_there_or_do_not_fit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CannotServe, match="weights not installed: nobody/nothing.*hf download"):
        prepare(tmp_path, "nobody/nothing")
    with pytest.raises(CannotServe, match="weights do not fit.*size mismatch for gain"):
        prepare(tmp_path, write_weights(tmp_path / "wide", {"gain": [1.0, 2.0]}))


@pytest.mark.usefixtures("stand_in")
def test_images_without_numbers_are_refused(tmp_path: Path) -> None:
    prepared = prepare(tmp_path, write_weights(tmp_path / "broken", {"gain": [np.nan]}), **FEW)
    with pytest.raises(CannotServe, match="NaN or infinite"):
        prepared.render(VIEW, 1)
    (tmp_path / "scene_0.h5").write_bytes(b"")
    with pytest.raises(CannotServe, match=r"ended with status 1: .*Error.*requirements.txt"):
        prepared.program.ask({"file": "nowhere", "resolution": 64, "image": "nowhere"})


def test_without_the_published_code_the_commands_that_bring_it_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scene_files: None
) -> None:
    monkeypatch.delenv(CODE.variable, raising=False)
    with pytest.raises(CannotServe, match=r"package not installed.*git clone.*pip install torch"):
        prepare(tmp_path, "anything")
    monkeypatch.setenv(CODE.variable, str(tmp_path))
    with pytest.raises(CannotServe, match="has no renderformer/pipelines/rendering_pipeline.py"):
        prepare(tmp_path, "anything")


GLASS = {"type": "sphere", "bsdf": {"type": "dielectric"}}
CHEQUERED = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "checkerboard"}}}


@pytest.mark.parametrize(
    ("objects", "reason"),
    [
        ({"glass": GLASS}, "no transmission"),
        ({"glass": GLASS, "board": CHEQUERED, "sky": {"type": "constant"}}, "no transmission"),
        ({"cut": {"type": "disk", "bsdf": {"type": "mask", "b": diffuse(1)}}}, "no transmission"),
        ({"board": CHEQUERED}, "no textures"),
        ({"sky": {"type": "constant"}}, "light of type ConstantBackground"),
        ({"sun": {"type": "point"}}, "light of type PointLight"),
        ({"odd": {"type": "disk", "bsdf": {"type": "principled"}}}, "materials of type Principled"),
        ({"ball": {"type": "sphere", "emitter": {"type": "area"}}}, "glowing triangles .*; 8 are"),
    ],
)
def test_what_the_network_never_saw_is_refused_whether_it_is_installed_or_not(
    tmp_path: Path, objects: dict[str, Any], reason: str
) -> None:
    with pytest.raises(CannotServe) as refusal:
        prepare(tmp_path, "anything", lit_room(**objects))
    assert refusal.match(reason)
    if reason.startswith("no t"):
        assert refusal.value.what == reason  # what tables show


def test_more_triangles_than_simplification_can_spare_are_refused(tmp_path: Path) -> None:
    boxes = {f"box_{k}": {"type": "cube", "bsdf": diffuse(0.5)} for k in range(4)}
    with pytest.raises(CannotServe, match="56 triangles, of which 56 remain.*50 are allowed"):
        prepare(tmp_path, "anything", lit_room(**boxes), triangles=50)


def test_the_networks_image_covers_the_images_pixels_exactly() -> None:
    assert supersampling((256, 256)) == supersampling((1280, 720)) == 1
    assert supersampling((8, 6)) == 32
    assert supersampling((9, 6)) == 30 and supersampling((1281, 720)) == 2
    image = np.arange(8 * 8).reshape(8, 8)
    np.testing.assert_array_equal(crop(image, (4, 2)), [[26, 27, 28, 29], [34, 35, 36, 37]])


@pytest.mark.slow
def test_the_published_network_takes_the_files_and_its_images_come_back(
    tmp_path: Path, scene_files: None
) -> None:
    try:
        folder = CODE.find()
    except CannotServe as missing:
        pytest.skip(f"needs the published network, a repository of its own: {missing}")
    weights = tmp_path / "weights"
    done = subprocess.run(
        [str(CODE.find_interpreter()), "-c", TINY, str(weights)],
        cwd=folder,
        env=os.environ | {"ATTN_IMPL": "sdpa"},
        capture_output=True,
        text=True,
    )
    # Who has its code and says where, has what it needs, or is to be told.
    assert done.returncode == 0, f"renderformer does not import: {done.stderr}"
    prepared = prepare(tmp_path, str(weights), **FEW)
    image = prepared.render(VIEW, 1)
    assert image.shape == (6, 9, 3) and np.isfinite(image).all() and image.std() > 0
    assert prepared.facts["parameters"] > 100_000
