"""One variant for the whole run, set before the test modules are imported.

A test that needs another one, or none, starts a process of its own.
"""

import os
from collections.abc import Iterator
from typing import Any

import pytest

pytest_plugins = ["tests.skips"]


def pytest_configure() -> None:
    from gpf.core.errors import UserError
    from gpf.core.runtime import choose_variant

    try:
        choose_variant("auto")
    except UserError as error:  # in words: a traceback through this file helps nobody
        raise pytest.UsageError(str(error)) from None
    if "PYTEST_XDIST_WORKER" in os.environ:  # one thread each, or all would wait for each other
        import drjit as dr

        dr.set_thread_count(1)
        dr.set_expand_threshold(0)  # see gpf.core.runtime.two_threads


@pytest.fixture
def two_threads() -> Iterator[None]:
    """For a test in which Mitsuba itself reads or writes an EXR file."""
    from gpf.core import runtime

    with runtime.two_threads():
        yield


@pytest.fixture
def asked_to_suppress(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """For each image of adaptive samples: whether fireflies were to be suppressed."""
    from gpf.rendering.adaptive import sample_adaptively

    asked = []

    def sample(*arguments: object) -> object:
        asked.append(arguments[5])
        return sample_adaptively(*arguments)

    monkeypatch.setattr("gpf.rendering.gpf.sample_adaptively", sample)
    return asked


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium for the pages of a module."""
    from tests.browser import start_browser

    with start_browser() as started:
        yield started
