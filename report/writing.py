"""Write a :class:`report.table.Table` as CSV, Markdown, LaTeX and HTML."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from gpf.core.files import write_text
from report.table import Column, Table


def write_table(table: Table, folder: Path) -> None:
    """Write the table into a folder, once in each format."""
    texts = {
        ".csv": table.frame.to_csv(index=False),
        ".md": to_markdown(table),
        ".tex": to_latex(table),
        ".html": to_html(table),
    }
    for suffix, text in texts.items():
        write_text(folder / (table.name + suffix), text)


@dataclass(frozen=True)
class Markup:
    """How a format writes labels and cells.

    Attributes
    ----------
    escape: turns plain text into text of the format.
    best, second, paper, reason: patterns for the best number, the second best, the paper's number
        and the number of a reason.
    """

    escape: Callable[[str], str]
    best: str
    second: str
    paper: str
    reason: str

    def label(self, table: Table, row: int) -> str:
        """A row's label."""
        text, reason = table.label_of(row)
        return self.escape(text) + _fill(self.reason, reason)

    def cell(self, table: Table, row: int, column: Column) -> str:
        """A number with the number of its reason and the paper's number."""
        text, paper, reason = table.cell(row, column)
        patterns = {"best": self.best, "second": self.second}
        text = patterns.get(table.marks.loc[row, column.key], "%s") % self.escape(text)
        return text + _fill(self.reason, reason) + _fill(self.paper, self.escape(paper))

    def reasons(self, table: Table, escape: Callable[[str], str]) -> list[str]:
        """The reasons below the table, each with its number."""
        return [f"{self.reason % k} {escape(why)}" for k, why in enumerate(table.reasons, start=1)]


def to_markdown(table: Table) -> str:
    """A table for GitHub: best in bold, second best underlined, the paper's in brackets."""
    headings = [_markdown_cell(text) for text in _headings(table)]
    lines = []
    for group, rows in table.groups.items():
        if table.grouped_by:
            lines.append([f"**{_markdown_cell(group)}**", *("" for _ in table.columns)])
        for row in rows:
            cells = [MARKDOWN.cell(table, row, column) for column in table.columns]
            lines.append([MARKDOWN.label(table, row), *cells])
    grid = pd.DataFrame(lines, columns=headings).to_markdown(
        index=False, disable_numparse=True, colalign=["left", *("right" for _ in table.columns)]
    )
    notes = [*map(escape_markdown, table.remarks), *MARKDOWN.reasons(table, escape_markdown)]
    title, caption = escape_markdown(table.title), escape_markdown(table.caption)
    parts = [f"### {title}", caption, grid, "  \n".join(notes)]
    return "\n\n".join(part for part in parts if part) + "\n"


def to_latex(table: Table) -> str:
    """A floating table; the document needs the package booktabs."""
    span = len(table.columns) + 1
    lines = [
        "% \\usepackage{booktabs}",
        "\\begin{table*}[t]",
        "\\centering\\footnotesize",
        f"\\caption{{\\textbf{{{escape_latex(table.title)}.}} {escape_latex(table.caption)}}}",
        f"\\label{{tab:{table.name}}}",
        f"\\begin{{tabular}}{{l{'r' * len(table.columns)}}}",
        "\\toprule",
        " & ".join(map(escape_latex, _headings(table))) + " \\\\",
    ]
    for group, rows in table.groups.items():
        lines.append("\\midrule")
        if table.grouped_by:
            lines.append(f"\\multicolumn{{{span}}}{{l}}{{\\textit{{{escape_latex(group)}}}}} \\\\")
        for row in rows:
            cells = [LATEX.cell(table, row, column) for column in table.columns]
            lines.append(" & ".join([LATEX.label(table, row), *cells]) + " \\\\")
    lines += ["\\bottomrule", "\\end{tabular}"]
    notes = [*map(escape_latex, table.remarks)]
    notes += [f"{reason}." for reason in LATEX.reasons(table, escape_latex)]
    if notes:
        lines += ["", "\\smallskip", "\\parbox{\\linewidth}{\\scriptsize " + " ".join(notes) + "}"]
    return "\n".join([*lines, "\\end{table*}", ""])


def to_html(table: Table) -> str:
    """A ``<figure class="table">`` with the table and its notes, without its title.

    CSS classes: ``best``, ``second``, ``missing``, ``paper`` (the paper's number), ``ours`` (rows
    of the field), ``group`` (headings of groups). Each group is a ``tbody``, so that sorting keeps
    groups together. For sorting, cells have the full number as ``data-value``, and headings
    say in ``data-better`` which numbers are better.
    """
    label, *titles = map(escape_html, _headings(table))
    head = f'<th scope="col">{label}</th>' + "".join(
        f'<th scope="col" data-key="{column.key}" data-better="{column.better}">{title}</th>'
        for column, title in zip(table.columns, titles, strict=True)
    )
    parts = [
        f'<figure class="table" id="{table.name}">',
        "<table>",
        f"<caption>{escape_html(table.caption)}</caption>",
        f"<thead><tr>{head}</tr></thead>",
    ]
    for group, rows in table.groups.items():
        parts.append("<tbody>")
        if table.grouped_by:
            span = len(table.columns) + 1
            heading = f'<th scope="rowgroup" colspan="{span}">{escape_html(group)}</th>'
            parts.append(f'<tr class="group">{heading}</tr>')
        parts += [_html_row(table, row) for row in rows]
        parts.append("</tbody>")
    parts.append("</table>")
    notes = [*map(escape_html, table.remarks), *HTML.reasons(table, escape_html)]
    if notes:
        parts.append("<figcaption>" + "".join(f"<p>{note}</p>" for note in notes) + "</figcaption>")
    return "\n".join([*parts, "</figure>", ""])


def _html_row(table: Table, row: int) -> str:
    cells = [f'<th scope="row">{HTML.label(table, row)}</th>']
    for column in table.columns:
        value = table.value(row, column)
        name = table.marks.loc[row, column.key] or ("missing" if value is None else "")
        attributes = f' class="{name}"' if name else ""
        if value is not None:
            attributes += f' data-value="{html.escape(str(value))}"'
        cells.append(f"<td{attributes}>{HTML.cell(table, row, column)}</td>")
    opening = '<tr class="ours">' if table.rows[row].ours else "<tr>"
    return opening + "".join(cells) + "</tr>"


def escape_markdown(text: str) -> str:
    """Escape text for one line of Markdown; text between backticks becomes code."""
    # Code needs no escaping.
    code = re.split("(`[^`]*`)", " ".join(text.split()))
    code[::2] = [re.sub(r"([*`])", r"\\\1", part).replace("<", "&lt;") for part in code[::2]]
    return "".join(code)


def _markdown_cell(text: str) -> str:
    """Escape text for a table cell, which a bar would end, even inside code."""
    return escape_markdown(text).replace("|", "\\|")


def escape_latex(text: str) -> str:
    """Escape text for LaTeX; text between backticks becomes code."""
    escaped = "".join(_LATEX.get(letter, letter) for letter in " ".join(text.split()))
    # After `\\`, LaTeX would read a bracket as the optional argument for vertical space.
    escaped = "{}" + escaped if escaped.startswith("[") else escaped
    return re.sub("`([^`]*)`", r"\\texttt{\1}", escaped)


def escape_html(text: str) -> str:
    """Escape text for HTML; text between backticks becomes code."""
    return re.sub("`([^`]*)`", r"<code>\1</code>", html.escape(text))


_LATEX = {
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
    "\\": "\\textbackslash{}",
    "~": "\\textasciitilde{}",
    "^": "\\textasciicircum{}",
    "|": "\\textbar{}",
    "<": "$<$",
    ">": "$>$",
    "–": "--",
    "−": "$-$",
    "×": "$\\times$",
    "±": "$\\pm$",
    "≈": "$\\approx$",
    "≤": "$\\le$",
    "≥": "$\\ge$",
    "↑": "$\\uparrow$",
    "↓": "$\\downarrow$",
    "Δ": "$\\Delta$",
    "²": "$^2$",
    "…": "\\dots{}",
}


def _headings(table: Table) -> list[str]:
    """The headings of the labels and of all columns; words are capitalised."""
    label = table.label
    label = label.capitalize() if len(label) > 1 else label  # but k stays k
    return [label, *map(table.heading, table.columns)]


def _fill(pattern: str, text: str) -> str:
    return pattern % text if text else ""


# GitHub underlines <ins>, but not <u>.
MARKDOWN = Markup(_markdown_cell, "**%s**", "<ins>%s</ins>", " (%s)", "<sup>%s</sup>")
LATEX = Markup(escape_latex, r"\textbf{%s}", r"\underline{%s}", " (%s)", r"\textsuperscript{%s}")
HTML = Markup(
    escape_html,
    "<strong>%s</strong>",
    "<u>%s</u>",
    ' <span class="paper">(%s)</span>',
    "<sup>%s</sup>",
)
