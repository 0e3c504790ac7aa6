"""A :class:`report.table.Table` as Markdown, LaTeX and HTML."""

from __future__ import annotations

import html
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from report.table import Table


def to_markdown(table: Table) -> str:
    """A table for a README: the best in bold, the second best underlined, the paper's in
    brackets."""
    headings = (_sentence(table.label), *map(table.heading, table.columns))
    lines = [[_markdown_cell(heading) for heading in headings]]
    lines.append([":--", *("--:" for _ in table.columns)])
    for group, rows in table.groups.items():
        if table.grouped_by:
            lines.append([f"**{_markdown_cell(group)}**", *("" for _ in table.columns)])
        for row in rows:
            label, why = table.label_of(row)
            cells = [_markdown_cell(label) + _sup(why)]
            for column in table.columns:
                text, paper, why = table.cell(row, column)
                text = _markdown_cell(text)
                mark = table.marks.loc[row, column.key]
                # GitHub shows <ins> underlined, and no <u>.
                text = {"best": f"**{text}**", "second": f"<ins>{text}</ins>"}.get(mark, text)
                cells.append(text + _sup(why) + (f" ({paper})" if paper else ""))
            lines.append(cells)
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    written = [
        "| " + " | ".join(_pad(k, cell, width) for k, (cell, width) in enumerate(cells)) + " |"
        for cells in (list(zip(line, widths, strict=True)) for line in lines)
    ]
    notes = [escape_markdown(remark) for remark in table.remarks]
    notes += [f"{_sup(str(k))} {escape_markdown(why)}" for k, why in _numbered(table)]
    title, caption = escape_markdown(table.title), escape_markdown(table.caption)
    parts = [f"### {title}", caption, "\n".join(written), "  \n".join(notes)]
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
        " & ".join(
            escape_latex(text)
            for text in (_sentence(table.label), *map(table.heading, table.columns))
        )
        + " \\\\",
    ]
    for group, rows in table.groups.items():
        lines.append("\\midrule")
        if table.grouped_by:
            lines.append(f"\\multicolumn{{{span}}}{{l}}{{\\textit{{{escape_latex(group)}}}}} \\\\")
        for row in rows:
            label, why = table.label_of(row)
            cells = [escape_latex(label) + _superscript(why)]
            for column in table.columns:
                text, paper, why = table.cell(row, column)
                text = escape_latex(text)
                mark = table.marks.loc[row, column.key]
                command = {"best": "textbf", "second": "underline"}.get(mark)
                text = f"\\{command}{{{text}}}" if command else text
                beside = f" ({escape_latex(paper)})" if paper else ""
                cells.append(text + _superscript(why) + beside)
            lines.append(" & ".join(cells) + " \\\\")
    lines += ["\\bottomrule", "\\end{tabular}"]
    notes = [escape_latex(remark) for remark in table.remarks]
    notes += [f"{_superscript(str(k))} {escape_latex(why)}." for k, why in _numbered(table)]
    if notes:
        lines += ["", "\\smallskip", "\\parbox{\\linewidth}{\\scriptsize " + " ".join(notes) + "}"]
    return "\n".join([*lines, "\\end{table*}", ""])


def to_html(table: Table) -> str:
    """``<figure class="table">`` with the table and its notes.

    Classes: ``best``, ``second``, ``missing``, ``paper`` (the paper's number), ``ours`` (rows of
    the field), ``group`` (headings of groups; each group is a ``tbody``, so that sorting stays
    inside it). Cells have their full number as ``data-value``, headings which way is better as
    ``data-better``.
    """
    head = f'<th scope="col">{escape_html(_sentence(table.label))}</th>' + "".join(
        f'<th scope="col" data-key="{column.key}" data-better="{column.better}">'
        f"{escape_html(table.heading(column))}</th>"
        for column in table.columns
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
    notes = [escape_html(remark) for remark in table.remarks]
    notes += [f"<sup>{k}</sup> {escape_html(why)}" for k, why in _numbered(table)]
    if notes:
        parts.append("<figcaption>" + "".join(f"<p>{note}</p>" for note in notes) + "</figcaption>")
    return "\n".join([*parts, "</figure>", ""])


def _html_row(table: Table, row: int) -> str:
    label, why = table.label_of(row)
    cells = [f'<th scope="row">{escape_html(label)}{_sup(why)}</th>']
    for column in table.columns:
        text, paper, why = table.cell(row, column)
        mark = table.marks.loc[row, column.key]
        value = table.value(row, column)
        name = mark or ("missing" if value is None else "")
        text = escape_html(text)
        text = {"best": f"<strong>{text}</strong>", "second": f"<u>{text}</u>"}.get(mark, text)
        beside = f' <span class="paper">({escape_html(paper)})</span>' if paper else ""
        attributes = f' class="{name}"' if name else ""
        if value is not None:
            attributes += f' data-value="{html.escape(str(value))}"'
        cells.append(f"<td{attributes}>{text}{_sup(why)}{beside}</td>")
    opening = '<tr class="ours">' if table.rows[row].ours else "<tr>"
    return opening + "".join(cells) + "</tr>"


def escape_markdown(text: str) -> str:
    """Text as GitHub shows it in a line, and what stands between backticks as code."""
    # Inside of code, nothing means anything but its end.
    code = re.split("(`[^`]*`)", " ".join(text.split()))
    code[::2] = [re.sub(r"([*`])", r"\\\1", part).replace("<", "&lt;") for part in code[::2]]
    return "".join(code)


def _markdown_cell(text: str) -> str:
    """The same in a table, where a bar would end the cell even inside of code."""
    return escape_markdown(text).replace("|", "\\|")


def escape_latex(text: str) -> str:
    """Text as LaTeX sets it, and what stands between backticks as code."""
    escaped = "".join(_LATEX.get(letter, letter) for letter in " ".join(text.split()))
    # After the end of a line, LaTeX would take it for how much room is to follow.
    escaped = "{}" + escaped if escaped.startswith("[") else escaped
    return re.sub("`([^`]*)`", r"\\texttt{\1}", escaped)


def escape_html(text: str) -> str:
    """Text as HTML shows it, and what stands between backticks as code."""
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


def _numbered(table: Table) -> list[tuple[int, str]]:
    return list(enumerate(table.reasons, start=1))


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] if len(text) > 1 else text


def _pad(place: int, text: str, width: int) -> str:
    """Labels to the left, numbers to the right; the line of dashes fills its cell."""
    if set(text) <= set(":-") and text:
        return ":" + "-" * (width - 1) if place == 0 else "-" * (width - 1) + ":"
    return text.ljust(width) if place == 0 else text.rjust(width)


def _sup(number: str) -> str:
    return f"<sup>{number}</sup>" if number else ""


def _superscript(number: str) -> str:
    return f"\\textsuperscript{{{number}}}" if number else ""
