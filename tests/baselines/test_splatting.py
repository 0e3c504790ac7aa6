"""3D Gaussian splatting, from pictures to pictures of a painted wall."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from baselines.options import SplattingOptions
from baselines.protocol import CannotServe
from baselines.splatting.baseline import FittedSplats, Splatting
from baselines.splatting.training import SplatTrainer
from gpf.core.images import tone_map, undo_tone_map
from tests.baselines.splat_cases import PICTURE_SIZE, photograph, place_view, wall_task

PLACES = [(-0.8, 0.1), (0.1, -0.5), (0.9, 0.2), (0.2, 0.8)]
NOVEL = place_view(0.3, 0.2)


def make_system(**options) -> Splatting:
    return Splatting(SplattingOptions(system="splatting", **{"gaussians": 400, **options}))


def psnr(prepared: FittedSplats, water: bool) -> float:
    """Of a view that was not trained with."""
    shown = tone_map(prepared.render(NOVEL, 0), 0.5)
    truth = tone_map(photograph(NOVEL, water).radiance, 0.5)
    return float(-10 * np.log10(np.mean((shown - truth) ** 2)))


@pytest.mark.parametrize("water", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_novel_view_comes_close_to_the_truth(tmp_path, water):
    pytest.importorskip("gsplat")
    task = wall_task(tmp_path, water, PLACES)
    after = {}
    for steps in (1, 200):
        (tmp_path / f"{steps}").mkdir()
        system = make_system(steps=steps, most=1000)
        after[steps] = system.prepare(replace(task, state=tmp_path / f"{steps}"))
    assert psnr(after[1], water) < 15
    assert psnr(after[200], water) > 25
    facts = after[200].facts
    assert facts["training_psnr"] > 27
    assert 400 < facts["gaussians"] <= 1050  # about 1000: the rule sees one step more
    assert facts["steps"] == 200
    assert "own kernels" in facts["rasteriser"]
    image = after[200].render(NOVEL, 0)
    assert image.dtype == np.float32 and image.shape == (*PICTURE_SIZE[::-1], 3)


def test_radiance_ends_at_the_clip(tmp_path):
    pytest.importorskip("gsplat")
    task = wall_task(tmp_path, False, PLACES[:2])
    image = make_system(steps=20).prepare(replace(task, exposure=5.0)).render(NOVEL, 0)
    assert image.max() == pytest.approx(1 / 5, rel=1e-4)
    assert (image >= 0).all()


def test_what_is_kept_is_what_is_counted(tmp_path):
    pytest.importorskip("gsplat")
    prepared = make_system(steps=1, degree=2).prepare(wall_task(tmp_path, False, PLACES))
    assert prepared.storage_bytes == 400 * 4 * (3 + 3 + 4 + 1 + 3 * 9)


def test_encoding_is_undone():
    radiance = np.linspace(0, 1, 50)
    np.testing.assert_allclose(undo_tone_map(tone_map(radiance, 1)), radiance, atol=1e-9)


class Killed(Exception):
    pass


def test_a_killed_training_goes_on(tmp_path, monkeypatch):
    """All of it counts: moments, the rule's counters, the order of pictures."""
    pytest.importorskip("gsplat")
    monkeypatch.setattr("baselines.splatting.training.CHECKPOINT_SECONDS", -1)
    task = wall_task(tmp_path, False, PLACES)

    def stop(done: int, total: int) -> None:
        if done == 18:
            raise Killed

    steps_made = []
    whole, killed = (replace(task, state=tmp_path / name) for name in ("whole", "killed"))
    whole.state.mkdir()
    killed.state.mkdir()
    system = make_system(steps=30, most=600)
    expected = system.prepare(whole)
    with pytest.raises(Killed):
        system.prepare(replace(killed, report=stop))
    found = system.prepare(replace(killed, report=lambda done, _: steps_made.append(done)))
    assert steps_made == list(range(18, 31))
    assert found.facts["gaussians"] == expected.facts["gaussians"] > 400
    # Sums of gradients depend on the order of their terms, and Adam makes whole steps of the
    # difference for a Gaussian that hardly counts: so it is images that are compared.
    ours, theirs = (p.render(NOVEL, 0) for p in (found, expected))
    assert abs(ours - theirs).mean() < 1e-4 * theirs.mean()


def test_a_damaged_checkpoint_is_as_none(tmp_path):
    pytest.importorskip("gsplat")
    (tmp_path / "splats.safetensors").write_bytes(b"half of it")
    assert make_system(steps=2).prepare(wall_task(tmp_path, False, PLACES)).facts["steps"] == 2


def test_there_are_hardly_more_than_there_may_be(tmp_path, monkeypatch):
    pytest.importorskip("gsplat")
    monkeypatch.setattr("baselines.splatting.training.PULL", 0.0)
    counts = []
    step = SplatTrainer.step

    def count(self: SplatTrainer) -> float:
        loss = step(self)
        counts.append(self.model.count)
        return loss

    monkeypatch.setattr(SplatTrainer, "step", count)
    make_system(steps=30, most=450).prepare(wall_task(tmp_path, False, PLACES))
    assert 430 < max(counts) < 480


def test_without_gsplat_there_are_words(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(CannotServe, match=r"pip install gsplat==1\.5\.3"):
        make_system(steps=2).prepare(wall_task(tmp_path, False, PLACES))


def test_without_views_there_are_words(tmp_path):
    with pytest.raises(CannotServe, match="no training views"):
        make_system(steps=2).prepare(wall_task(tmp_path, False, []))


def test_black_views_are_refused(tmp_path):
    task = wall_task(tmp_path, False, PLACES[:1])
    task.training[0].layers["radiance"][:] = 0
    with pytest.raises(CannotServe, match="all training views are black"):
        make_system(steps=2).prepare(task)
