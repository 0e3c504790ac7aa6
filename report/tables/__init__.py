"""All tables of the report, with measured numbers and the paper's."""

from __future__ import annotations

from pathlib import Path

from report.results import Results
from report.table import Table
from report.tables.ablations import ablation_tables
from report.tables.costs import cost_table, time_table
from report.tables.equal import equal_quality_table, equal_time_table
from report.tables.flicker import flicker_table
from report.tables.quality import glance_table, learned_table, systems_table
from report.writing import write_table

__all__ = ["make_tables", "write_tables"]


def make_tables(results: Results) -> list[Table]:
    """All tables, in the order of the report."""
    return [
        glance_table(results),
        systems_table(results),
        learned_table(results),
        *ablation_tables(results),
        time_table(results),
        cost_table(results),
        equal_time_table(results),
        equal_quality_table(results),
        flicker_table(results),
    ]


def write_tables(results: Results, folder: Path) -> list[Table]:
    """Write all tables as CSV, Markdown, LaTeX and HTML."""
    tables = make_tables(results)
    for table in tables:
        write_table(table, folder)
    return tables
