"""A table: ranks, reasons, and its four formats."""

from __future__ import annotations

import csv
from html.parser import HTMLParser
from io import StringIO

import pytest

from report.formats import fixed, join, signed, significant, whole
from report.table import Column, Row, Table
from report.writing import to_html, to_latex, to_markdown

SPEED = Column("speed", "Speed & rate", fixed(1), "higher")
ERROR = Column("error", "Error", significant(2), "lower", rank_zero=False)
NOTE = Column("note", "How")

TABLE = Table(
    name="made_up",
    title="Made up: 100% of it_all",
    caption="Costs $ & {time} #1 <b> in `code_here`.",
    columns=(SPEED, ERROR, NOTE),
    rows=(
        Row("slow | one", {"speed": 1.04, "error": 0.5, "note": "a_b"}, {"speed": 0.95}),
        Row("fast", {"speed": 20.0, "error": 0.0, "note": ""}, ours=True),
        Row("as fast", {"speed": 20.04, "error": 0.25, "note": ""}),
        Row("fastest", {"speed": 99.0, "error": 0.001, "note": ""}, competes=False),
        Row("gone", {}, {"speed": 3.0}, reasons={"": "no <time> for 5%"}),
        Row("half", {"speed": float("nan"), "error": 12.34, "note": ""}, reasons={"speed": "why"}),
        Row("alone", {"speed": 7.0, "error": 3.0, "note": ""}, group="other"),
    ),
    grouped_by="kind",
    remarks=("A remark.",),
)


def test_best_and_second_best():
    assert TABLE.marks["speed"].tolist() == ["second", "best", "best", "", "", "", ""]
    # 0 is not ranked in this column, and a single number in a group has no rank.
    assert TABLE.marks["error"].tolist() == ["second", "", "best", "", "", "", ""]
    assert not TABLE.marks["note"].any()


def test_csv_has_measured_numbers_the_papers_and_ranks():
    rows = list(csv.DictReader(StringIO(TABLE.frame.to_csv(index=False))))
    assert list(rows[0]) == [
        *("kind", "method", "speed", "speed_paper", "speed_rank", "error", "error_rank", "note"),
        "reason",
    ]
    assert [row["speed_rank"] for row in rows] == ["2", "1", "1", "", "", "", ""]
    assert rows[2]["speed"] == "20.04" and rows[0]["speed_paper"] == "0.95"
    assert rows[4]["speed"] == "" and rows[4]["reason"] == "no <time> for 5%"


def test_markdown_is_aligned_and_marks_the_best_and_second():
    lines = to_markdown(TABLE).splitlines()
    table = [line for line in lines if line.startswith("|")]
    assert len({len(line) for line in table}) == 1
    cells = [[cell.strip() for cell in line.split(" | ")] for line in table]
    assert cells[0] == ["| Method", "Speed & rate ↑ (paper)", "Error ↓", "How |"]
    assert cells[3] == ["| slow \\| one", "<ins>1.0</ins> (0.9)", "<ins>0.50</ins>", "a_b |"]
    assert cells[5][1:3] == ["**20.0**", "**0.25**"]
    assert cells[7] == ["| gone<sup>1</sup>", "– (3.0)", "–", "– |"]
    assert cells[8][:2] == ["| half", "–<sup>2</sup>"]
    assert cells[9][0] == "| **other**"
    assert lines[0] == "### Made up: 100% of it_all"
    assert lines[-3:] == ["A remark.  ", "<sup>1</sup> no &lt;time> for 5%  ", "<sup>2</sup> why"]


def test_markdown_cells_stay_on_one_line():
    label, why = "two\nlines * `a|b`", "a | b `x<y|z` `<"
    table = Table("t", "T", "", (SPEED,), (Row(label, {}, reasons={"": why}),))
    text = to_markdown(table)
    assert "| two lines \\* `a\\|b`<sup>1</sup> |" in text
    assert text.endswith("<sup>1</sup> a | b `x<y|z` \\`&lt;\n")


def test_only_missing_numbers_have_reasons():
    reasons = {"speed": "not timed", "error": "no image"}
    rows = (
        Row("whole", {"speed": 1.0, "error": 0.5}, reasons=reasons),
        Row("half", {"speed": 1.0}, reasons=reasons),
    )
    frame = Table("t", "T", "", (SPEED, ERROR), rows).frame
    assert frame["reason"].tolist() == ["", "no image"]


def test_latex_rows_may_begin_with_a_bracket():
    text = to_latex(Table("t", "T", "", (SPEED,), (Row("[a|b]", {"speed": 1.0}),)))
    assert "\n{}[a\\textbar{}b] & 1.0 \\\\\n" in text


def test_latex_escapes_and_has_booktabs():
    text = to_latex(TABLE)
    assert "\\textbf{Made up: 100\\% of it\\_all.}" in text
    assert "Costs \\$ \\& \\{time\\} \\#1 $<$b$>$ in \\texttt{code\\_here}." in text
    assert "Speed \\& rate $\\uparrow$ (paper) & Error $\\downarrow$ & How \\\\" in text
    assert "\\underline{1.0} (0.9) & \\underline{0.50} & a\\_b \\\\" in text
    assert "\\textbf{20.0} & \\textbf{0.25}" in text
    assert "gone\\textsuperscript{1} & -- (3.0) & -- & -- \\\\" in text
    assert "\\textsuperscript{1} no $<$time$>$ for 5\\%." in text
    assert [text.count(f"\\{rule}rule") for rule in ("top", "mid", "bottom")] == [1, 2, 1]
    assert text.count("{") - text.count("\\{") == text.count("}") - text.count("\\}")
    body = [line for line in text.splitlines() if line.endswith("\\\\") and "column" not in line]
    assert {line.replace("\\&", "").count("&") for line in body} == {3}


class Page(HTMLParser):
    """The cells of a table; asserts that all tags are closed in the right order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.cells = [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.open.append(tag)
        if tag in ("td", "th"):
            self.cells.append([tag, dict(attributes), ""])

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.cells and {"td", "th"} & set(self.open):
            self.cells[-1][2] += data


def test_html_marks_the_best_and_what_is_missing():
    text = to_html(TABLE)
    page = Page(text)
    assert not page.open and text.startswith('<figure class="table" id="made_up">')
    heads = [cell for cell in page.cells if cell[1].get("scope") == "col"]
    assert [head[1].get("data-better") for head in heads] == [None, "higher", "lower", ""]
    data = [cell for cell in page.cells if cell[0] == "td"]
    assert len(data) == 7 * 3
    assert data[0][1:] == [{"class": "second", "data-value": "1.04"}, "1.0 (0.9)"]
    assert data[3][1]["class"] == "best" and "<strong>20.0</strong>" in text
    assert data[12][1] == {"class": "missing"} and data[12][2] == "– (3.0)"
    assert text.count("<tbody>") == 2 and text.count('<tr class="ours">') == 1
    assert "no &lt;time&gt; for 5%" in text and "<code>code_here</code>" in text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        *((49.525, "49.5"), (0.14482, "0.145"), (9.996, "10.0"), (0.09996, "0.100")),
        *((14010.0, "14,010"), (999.6, "1,000"), (1203.4, "1,203"), (0.0, "0"), (-2.345, "-2.35")),
    ],
)
def test_three_significant_digits(value, text):
    assert significant(3)(value) == text


def test_other_formats():
    assert fixed(2)(9.276) == "9.28" and whole(100000.0) == "100,000"
    assert (signed(2)(-0.5), signed(2)(0.25)) == ("−0.50", "+0.25")
    assert [join(["a"]), join(["a", "b", "c"]), join([])] == ["a", "a, b and c", ""]
