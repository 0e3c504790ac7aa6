"""Checkpoints of a fit, its schedule, and recorded functions."""

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from baselines.neural.fitting import Fit, Recorded, digest
from gpf.training.settings import cosine_decay


def make_fit(step: int = 0) -> Fit:
    """Two parameters after some steps of gradient descent on the square of each."""
    fit = Fit([mi.Float(1, 2, 3), mi.Float(-4, 5)])
    for _ in range(step):
        rates = [mi.Float(0.1), mi.Float(0.2)]
        fit.values = fit.adam.step(fit.values, [2 * v for v in fit.values], rates, fit.step + 1)
        fit.step += 1
    return fit


def contents(fit: Fit) -> list[list[float]]:
    return [list(v) for v in (*fit.values, *fit.adam.first, *fit.adam.second)]


def test_a_checkpoint_has_all_that_the_next_step_needs(tmp_path: Path):
    fit, path = make_fit(3), tmp_path / "fit.safetensors"
    fit.save(path, {"a": (1, 2)}, {"extra": np.arange(4)})
    restored = make_fit()
    more = restored.restore(path, {"a": (1, 2)})
    assert more is not None and list(more) == ["extra"] and list(more["extra"]) == [0, 1, 2, 3]
    assert restored.step == 3
    assert contents(restored) == contents(fit)
    assert contents(restored) != contents(make_fit())


@pytest.mark.parametrize("what", ["nothing", "other", "damaged"])
def test_what_does_not_belong_to_the_fit_is_left_alone(tmp_path: Path, what: str):
    path = tmp_path / "fit.safetensors"
    if what != "nothing":
        make_fit(3).save(path, {"a": 1 if what == "damaged" else 2})
    if what == "damaged":
        path.write_bytes(path.read_bytes()[:-9])
    fit = make_fit()
    assert fit.restore(path, {"a": 1}) is None
    assert fit.step == 0 and contents(fit) == contents(make_fit())


def test_the_rate_decays_like_a_cosine():
    assert cosine_decay(0, 0.1) == 1
    assert cosine_decay(0.5, 0.1) == pytest.approx(0.55)
    assert cosine_decay(1, 0.1) == pytest.approx(0.1) == cosine_decay(1.5, 0.1)


def test_a_digest_tells_contents_apart():
    a = np.arange(6.0)
    assert digest(a, a) == digest(a.copy(), a)
    assert digest(a, a) != digest(a, a + 1)


class Counter:
    """Counts how often it is traced."""

    calls = 0

    def double(self, x: mi.Float, y: list[mi.Float]) -> mi.Float:
        self.calls += 1
        return 2 * x + y[0]


def test_a_recorded_function_answers_for_the_arguments_of_each_call():
    counter = Counter()
    recorded = Recorded(counter.double)
    for k in range(5):
        x = dr.opaque(mi.Float, k, 3) + mi.Float(0, 1, 2)
        y = [dr.opaque(mi.Float, 10 * k)]
        dr.eval(x, y)
        assert list(recorded(x, y)) == [2 * (k + i) + 10 * k for i in range(3)]
    assert counter.calls < 5
