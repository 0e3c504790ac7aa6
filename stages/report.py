"""Stage `report`: tables, figures and a page with the results of all scenes."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.table import Table as Grid
from rich.text import Text

from gpf.core.errors import UserError
from gpf.core.progress import console, say
from report.figures import draw_figures
from report.page import write_page
from report.results import Results
from report.table import Table
from report.tables import write_tables


def run() -> None:
    """Write results/tables, results/figures and results/report.html; print the PSNR of Table 1."""
    results = Results.open()
    if not results.scenes:
        raise UserError(
            str(results.root),
            f"has no results for any scene of params.yaml ({', '.join(results.params.scenes)}) "
            f"against {results.passes} passes of SPPM",
            "Run `dvc repro`, or the stages of one scene up to `gpf stage metrics --scene "
            f"{results.params.scenes[0]}`.",
        )
    root = results.root
    tables = write_tables(results, root / "tables")
    figures = draw_figures(results, root / "figures")
    write_page(results, tables, figures, root / "report.html")
    console.print(show(tables[0]))
    for note in tables[0].notes:
        say(f"  {note}")
    left_out = [figure for figure in figures if figure.reason]
    for figure in left_out:
        say(f"no figure {figure.name}: {figure.reason}")
    say(f"{len(tables)} tables in {root / 'tables'}: CSV, Markdown, LaTeX, HTML")
    say(f"{len(figures) - len(left_out)} figures in {root / 'figures'}: SVG, PNG")
    size = (root / "report.html").stat().st_size / 1e6
    say(f"all on one page, {size:.1f} MB: {root / 'report.html'}")


def show(table: Table) -> Grid:
    """A table for the terminal, without the paper's numbers, because a terminal is narrow."""
    grid = Grid(title=table.title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    grid.add_column(table.label.capitalize(), no_wrap=True)
    for column in table.columns:
        grid.add_column(column.title, justify="right")
    for row in range(len(table.rows)):
        label, why = table.label_of(row)
        cells = [Text(label + (f" [{why}]" if why else ""))]
        for column in table.columns:
            text, _, why = table.cell(row, column)
            style = {"best": "bold", "second": "underline"}.get(table.marks.loc[row, column.key])
            cells.append(Text(text, style=style or "").append(f" [{why}]" if why else ""))
        grid.add_row(*cells)
    return grid
