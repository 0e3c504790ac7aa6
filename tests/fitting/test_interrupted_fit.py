"""A fit that is interrupted or killed, and goes on."""

from __future__ import annotations

import drjit as dr
import pytest

import gpf
from gpf.core.files import read_tensors
from gpf.fitting import plan
from gpf.fitting.field_series import FieldSeries
from gpf.fitting.state import PHOTONS
from gpf.training.streaming import PhotonStream
from tests.small_fit import assert_same_gaussians, sensors

pytestmark = pytest.mark.usefixtures("small")


def test_interrupted_the_best_field_so_far_is_returned(scene, monkeypatch):
    monkeypatch.setattr(plan, "FIRST_PASSES", 12)

    def stop(progress):
        if progress.psnr is not None:
            raise KeyboardInterrupt

    field = gpf.fit(scene, sensors(), target_psnr=90, callback=stop)
    assert field.record["estimated_psnr"] > 20 and dr.width(field.gaussians.means) > 0


def test_before_the_first_field_an_interrupt_ends_the_fit(scene):
    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        gpf.fit(scene, sensors(), passes=30, callback=stop)


def test_unused_photons_of_a_state_are_used(scene, monkeypatch, clock, tmp_path):
    """Interrupted in the second field, with photons for it, and time for a few more."""
    monkeypatch.setattr(plan, "FIRST_PASSES", 12)

    def stop(progress):
        clock.count(progress)
        if progress.passes == 36 and progress.steps == 5:
            raise KeyboardInterrupt

    state = tmp_path / "box.fit"
    field = gpf.fit(scene, sensors(), passes=36, callback=stop, state=state)
    assert field.record["passes"] == 12
    field = gpf.fit(scene, sensors(), seconds=2, state=state, callback=clock.count)
    assert 36 <= field.record["passes"] < 1.25 * 36
    whole = gpf.fit(scene, sensors(), passes=field.record["passes"])
    assert_same_gaussians(field, whole)


def test_a_fit_that_was_interrupted_before_light_was_gathered_gathers_it(
    scene, monkeypatch, tmp_path
):
    def interrupt(stream, *arguments):
        raise KeyboardInterrupt

    def has_gathered() -> bool:
        tensors, _ = read_tensors(state / PHOTONS, "fit")
        return any(name.startswith("gathered/") for name in tensors)

    state = tmp_path / "box.fit"
    with monkeypatch.context() as once:
        once.setattr(PhotonStream, "light_by", interrupt)
        gpf.fit(scene, sensors(), passes=12, state=state)
    assert not has_gathered()
    field = gpf.fit(scene, sensors(), passes=12, state=state)
    assert has_gathered()
    assert_same_gaussians(field, gpf.fit(scene, sensors(), passes=12))


def test_light_that_one_field_has_gathered_is_not_continued_by_another(
    scene, monkeypatch, tmp_path
):
    """The draft gathers light for the last field of a fit, which nothing follows."""
    gathering, light_by, restore = [], PhotonStream.light_by, PhotonStream.restore

    def gather(stream, field, *arguments):
        gathering.append(field)
        light_by(stream, field, *arguments)

    def go_on(stream, tensors, field):
        gathering.append(field)
        restore(stream, tensors, field)

    monkeypatch.setattr(PhotonStream, "light_by", gather)
    monkeypatch.setattr(PhotonStream, "restore", go_on)
    state = tmp_path / "box.fit"
    best = gpf.fit(scene, sensors(), passes=12, state=state)
    draft = gathering[-1]
    assert draft is not best
    gpf.fit(scene, sensors(), passes=18, state=state)
    assert_same_gaussians(gathering[1], draft)
    assert_same_gaussians(gathering[2], best)  # from now on


def test_a_field_whose_judgement_was_interrupted_is_fitted_again(scene, monkeypatch, tmp_path):
    monkeypatch.setattr(plan, "FIRST_PASSES", 12)
    add_error = FieldSeries.add_error

    def interrupt(self, field, fitted):
        if self.stream.count > 12:
            raise KeyboardInterrupt
        add_error(self, field, fitted)

    state = tmp_path / "box.fit"
    with monkeypatch.context() as once:
        once.setattr(FieldSeries, "add_error", interrupt)
        assert gpf.fit(scene, sensors(), passes=30, state=state).record["passes"] == 12
    assert gpf.fit(scene, sensors(), passes=30, state=state).record["passes"] == 30


def test_a_first_field_whose_judgement_was_interrupted_at_its_end_is_kept(
    scene, monkeypatch, tmp_path
):
    judge = FieldSeries.judge

    def interrupt(self, *arguments):
        judge(self, *arguments)
        raise KeyboardInterrupt

    state = tmp_path / "box.fit"
    with monkeypatch.context() as once:
        once.setattr(FieldSeries, "judge", interrupt)
        assert gpf.fit(scene, sensors(), passes=12, state=state).record["passes"] == 12
    field = gpf.fit(scene, sensors(), passes=18, state=state)
    assert field.record["passes"] == 18


@pytest.mark.slow
def test_a_killed_fit_goes_on_and_gives_the_same_bits(scene, tmp_path, monkeypatch):
    monkeypatch.setattr("gpf.fitting.state.SAVE_SECONDS", 0)  # after each pass
    whole = gpf.fit(scene, sensors(), passes=75, seed=3)

    def stop(progress):
        if progress.passes == 50:
            raise RuntimeError("killed")

    with pytest.raises(RuntimeError, match="killed"):
        gpf.fit(scene, sensors(), passes=75, seed=3, callback=stop, state=tmp_path / "box.fit")
    told = []
    field = gpf.fit(
        scene, sensors(), passes=75, seed=3, callback=told.append, state=tmp_path / "box.fit"
    )
    assert 24 < told[0].passes <= 51
    assert_same_gaussians(field, whole)
    assert field.record["estimated_psnr"] == whole.record["estimated_psnr"]
    more = gpf.fit(scene, sensors(), passes=100, seed=3, state=tmp_path / "box.fit")
    assert more.record["passes"] == 100
    brighter = gpf.fit(
        scene, sensors(), passes=100, seed=3, state=tmp_path / "box.fit", exposure=3.0
    )
    assert brighter.record["exposure"] == 3 and brighter.record["passes"] == 100
    other = gpf.fit(scene, sensors(), passes=24, seed=4, state=tmp_path / "box.fit")
    assert other.record["passes"] == 24  # photons of another seed are not used
