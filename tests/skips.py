"""Skipped tests: one line for each reason; with CI=true a failure, unless a list has the reason."""

from __future__ import annotations

import os
from collections import Counter

import pytest

# File of tests -> words of the reason for which tests there may be skipped.
ALLOWED = {
    "tests/baselines/test_renderformer.py": "needs the published network, a repository of its own",
    "tests/stages/importing/test_importer.py": "needs the original scenes",
    "tests/scenes/test_originals.py": "needs the original scenes, no part of this repository",
    "tests/faults/test_commands.py": "only root can mount a file system with a size limit",
    "tests/faults/test_disks.py": "only root can mount a file system with a size limit",
    "tests/baselines/test_hash_encoding.py": "half precision on CUDA",
}


def reason_of(report: pytest.TestReport | pytest.CollectReport) -> str:
    """Why a test was skipped."""
    told = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return told.removeprefix("Skipped: ")


def check(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Make a skip that is not allowed a failure. One that is expected to fail is no skip."""
    if os.environ.get("CI") != "true" or not report.skipped or hasattr(report, "wasxfail"):
        return
    reason = reason_of(report)
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


def pytest_terminal_summary(terminalreporter):
    """Print how many tests were skipped for each reason."""
    skipped = terminalreporter.stats.get("skipped", [])
    for reason, count in Counter(map(reason_of, skipped)).items():
        terminalreporter.write_line(f"SKIPPED [{count}] {reason}", yellow=True)
