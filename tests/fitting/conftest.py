"""Small fits of the Cornell box. Modules are imported late: gpf has to be the first."""

import pytest


@pytest.fixture(scope="module")
def scene():
    import mitsuba as mi

    return mi.load_dict(mi.cornell_box(), optimize=False)


@pytest.fixture
def small(monkeypatch):
    """A fit takes a second."""
    from tests.small_fit import make_small

    make_small(monkeypatch, passes=30, steps=60, paths=5_000)


@pytest.fixture
def clock(monkeypatch):
    """The only clock of a fit that has it as its callback, ``clock.count``."""
    from tests.small_fit import Clock

    clock = Clock()
    monkeypatch.setattr("gpf.fitting.state.time", clock)
    monkeypatch.setattr("gpf.fitting.goals.time", clock)
    monkeypatch.setattr("gpf.fitting.goals._seconds_of_compiling", lambda: 0.0)
    return clock
