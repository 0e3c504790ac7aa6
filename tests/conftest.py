"""One variant for the whole run, set before the test modules are imported.

A test that needs another one, or none, starts a process of its own.
"""

import pytest


def pytest_configure() -> None:
    from gpf.errors import UserError
    from gpf.runtime import choose_variant

    try:
        choose_variant("auto")
    except UserError as error:  # in words: a traceback through this file helps nobody
        raise pytest.UsageError(str(error)) from None
