"""Stage `report`: the files that it writes and its messages."""

from __future__ import annotations

import pytest

from gpf.core.errors import UserError
from report.figures.sketch import Figure
from report.results import Results
from stages import report as stage
from tests.report.made_up import made_up_params, make_results


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """The stage in an empty folder; stubs stand in for figures and page."""
    calls = {}

    def draw_figures(results, folder):
        calls["figures"] = folder
        return [Figure("teaser", "Teaser"), Figure("views", "Views", reason="no images")]

    def write_page(results, tables, figures, path):
        calls["page"] = [table.name for table in tables], [figure.name for figure in figures]
        path.write_text("page")

    monkeypatch.setattr(stage, "draw_figures", draw_figures)
    monkeypatch.setattr(stage, "write_page", write_page)
    monkeypatch.setattr(Results, "open", classmethod(lambda cls: cls(made_up_params())))
    monkeypatch.chdir(tmp_path)
    return calls


def test_tables_figures_page_and_messages(drawn, tmp_path, capsys):
    make_results(tmp_path / "results")
    stage.run()
    assert (tmp_path / "results" / "tables" / "table_1.csv").exists()
    assert str(drawn["figures"]) == "results/figures"
    tables, figures = drawn["page"]
    assert tables[:2] == ["table_1_psnr", "table_1"] and figures == ["teaser", "views"]
    said = " ".join(capsys.readouterr().err.split())
    assert "Table 1 at a glance" in said and "Path tracer, 50 spp" in said
    assert "no figure views: no images" in said and "1 figures in results/figures" in said
    assert "glass and water are beyond it" in said and "results/report.html" in said


def test_without_results_the_error_names_the_command(drawn, tmp_path):
    with pytest.raises(UserError, match=r"results: has no results for any scene.*`dvc repro`.*"):
        stage.run()
    assert not list(tmp_path.iterdir())
