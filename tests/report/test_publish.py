"""Tables and pictures in the README: all of a complete report, or nothing."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from gpf.core.errors import UserError
from report.results import Results
from stages.commands.profiles import apply_profile
from stages.config.params import read_params

PROJECT = Path(__file__).parents[2]

PAGE = "before\n<!-- k -->\nold\n<!-- /k -->\nafter\n"
TABLE = "# Title\n\nCaption.\n\n| a |\n| - |\n| {cell} |\n\n<sup>1</sup> {reason}\n"


@pytest.fixture
def publish(tmp_path, monkeypatch):
    """The script, in a folder with a table and a picture of a run with the profile `full`."""
    spec = importlib.util.spec_from_file_location("publish", PROJECT / "docs" / "publish.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "PICTURES", ("teaser",))
    monkeypatch.setattr(module, "FILMS", ())
    monkeypatch.chdir(tmp_path)
    (tmp_path / "params.yaml").write_text((PROJECT / "params.yaml").read_text())
    apply_profile("full", tmp_path / "params.yaml")
    Path("README.md").write_text(PAGE)
    for folder in ("results/tables", "results/figures", "docs"):
        Path(folder).mkdir(parents=True)
    for scene in read_params(Path("params.yaml")).scenes:
        Path("results", scene, "metrics").mkdir(parents=True)
        Path("results", scene, "convergence.json").write_text('[{"passes": 1000, "psnr": 40}]')
    Path("results/figures/teaser.png").write_bytes(b"new")
    Path("results/tables/k.md").write_text(TABLE.format(cell=31.5, reason="no transmission"))
    return module


def run(module):
    module.publish(Results(read_params(Path("params.yaml")), Path("results")))


def test_a_table_and_a_picture_are_published(publish):
    run(publish)
    body = TABLE.format(cell=31.5, reason="no transmission").split("\n", 2)[2].strip()
    assert Path("README.md").read_text() == PAGE.replace("old", body)
    assert Path("docs/images/teaser.png").read_bytes() == b"new"


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda: apply_profile("desk", Path("params.yaml")), r"reference\.passes.*250, not 1000"),
        (lambda: Path("results/tables/k.md").unlink(), r"k\.md.*missing"),
        (lambda: Path("results/figures/teaser.png").unlink(), r"teaser\.png.*missing"),
        (
            lambda: Path("results/tables/k.md").write_text(
                TABLE.format(cell="–", reason="not run; 3 training views are needed")
            ),
            r"k\.md.*not complete.*to its end",
        ),
        (
            lambda: Path("results/tables/k.md").write_text(
                TABLE.format(cell=1, reason="b") + "Not animated yet: Water Caustic.\n"
            ),
            r"k\.md.*not complete.*to its end",
        ),
        (
            lambda: Path("results/veach_ajar/metrics").rmdir(),
            r"no numbers of veach_ajar with 1000 passes.*to its end",
        ),
        (
            lambda: Path("results/veach_ajar/convergence.json").write_text(
                '[{"passes": 250, "psnr": 40}]'
            ),
            r"no numbers of veach_ajar with 1000 passes",
        ),
    ],
)
def test_an_incomplete_report_is_not_published(publish, spoil, said):
    spoil()
    with pytest.raises(UserError, match=said):
        run(publish)
    assert Path("README.md").read_text() == PAGE and not Path("docs/images").exists()
