"""With CI=true, a test that is skipped fails, unless it is on a list with the reason."""

from __future__ import annotations

import os

import pytest

# File of tests -> words of the reason for which tests there may be skipped.
ALLOWED = {
    "tests/baselines/test_renderformer.py": "the published network is a repository of its own",
    "tests/importing/test_importer.py": "the authors' own scenes are no part of this repository",
    "tests/scenes/test_originals.py": "the authors' own scenes are no part of this repository",
    "tests/baselines/test_hash_encoding.py": "half precision on CUDA",
}


def check(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Make a skip that is not allowed a failure. One that is expected to fail is no skip."""
    if os.environ.get("CI") != "true" or not report.skipped or hasattr(report, "wasxfail"):
        return
    reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    allowed = ALLOWED.get(report.nodeid.partition("::")[0])
    if allowed is None or allowed not in reason:
        report.outcome = "failed"
        report.longrepr = f"{reason}\nIn CI nothing is skipped, but what tests/skips.py allows."


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """A test's report."""
    report = yield
    check(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """The report of a file that skips itself."""
    report = yield
    check(report)
    return report
