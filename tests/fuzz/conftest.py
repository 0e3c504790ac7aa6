"""Each run tries the same cases, unless another of Hypothesis's profiles is named."""

import pytest
from hypothesis import settings


def pytest_configure(config: pytest.Config) -> None:
    if not config.getoption("--hypothesis-profile"):
        settings.load_profile("ci")
