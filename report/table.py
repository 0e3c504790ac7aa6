"""A table of measured numbers, with the paper's numbers, ranks, and reasons for missing numbers.

:mod:`report.writing` writes it as CSV, Markdown, LaTeX and HTML.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import pandas as pd

from report.formats import Form

Value = float | str | None

MISSING = "–"
"""The text of a missing number."""


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    key: its name in the frame and in CSV.
    title: its heading.
    form: writes a number as text; a cell may also hold text.
    better: which numbers are better; "" for a column without ranks.
    rank_zero: whether 0 is ranked. A method that stores no file does not win by file size.
    """

    key: str
    title: str
    form: Form = str
    better: Literal["higher", "lower", ""] = ""
    rank_zero: bool = True

    @property
    def arrow(self) -> str:
        """An arrow towards better numbers."""
        return {"higher": " ↑", "lower": " ↓", "": ""}[self.better]


@dataclass(frozen=True)
class Row:
    """A row of a table.

    Attributes
    ----------
    values, paper: measured and reported numbers, by column key; missing ones are absent or NaN.
    group: rows of a group stand together and are ranked only against each other.
    reasons: why a value is missing, by column key; the key "" is for the whole row.
    competes: whether the row is ranked.
    ours: whether it is the field's row.
    """

    label: str
    values: Mapping[str, Value]
    paper: Mapping[str, float] = field(default_factory=dict)
    group: str = ""
    reasons: Mapping[str, str] = field(default_factory=dict)
    competes: bool = True
    ours: bool = False


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    name: base name of its files.
    title, caption: what it shows, and how to read it.
    label: the heading of the rows' labels.
    grouped_by: the column name of the groups; "" without groups.
    remarks: notes below the table. The reasons for missing numbers follow them.
    """

    name: str
    title: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    label: str = "method"
    grouped_by: str = ""
    remarks: tuple[str, ...] = ()

    @cached_property
    def frame(self) -> pd.DataFrame:
        """The numbers, not rounded: the group, the label, and for each column the measured value
        (``psnr``), the paper's value if any row has one (``psnr_paper``), and the rank if the
        column is ranked (``psnr_rank``: 1, 2 or missing); last the ``reason`` for missing ones."""
        frame = pd.DataFrame(index=range(len(self.rows)))
        if self.grouped_by:
            frame[self.grouped_by] = [row.group for row in self.rows]
        frame[self.label] = [row.label for row in self.rows]
        for column in self.columns:
            frame[column.key] = [_known(row.values.get(column.key)) for row in self.rows]
            if self.has_paper(column):
                frame[f"{column.key}_paper"] = [row.paper.get(column.key) for row in self.rows]
            if column.better:
                ranks = self.marks[column.key].map({"best": 1, "second": 2, "": pd.NA})
                frame[f"{column.key}_rank"] = ranks.astype("Int64")
        reasons = (self._reasons(row).values() for row in self.rows)
        frame["reason"] = ["; ".join(dict.fromkeys(found)) for found in reasons]
        return frame

    @cached_property
    def marks(self) -> pd.DataFrame:
        """``"best"``, ``"second"`` or ``""`` for each row and column key.

        Numbers with the same text have the same rank.
        """
        marks = pd.DataFrame(
            "", index=range(len(self.rows)), columns=[c.key for c in self.columns], dtype=object
        )
        for column in (c for c in self.columns if c.better):
            for rows in self.groups.values():
                for row, mark in self._places(column, rows).items():
                    marks.loc[row, column.key] = mark
        return marks

    def _places(self, column: Column, rows: Sequence[int]) -> dict[int, str]:
        """The best and the second best of these rows."""
        values: dict[str, float] = {}
        texts: dict[int, str] = {}
        for row in rows:
            value = self.value(row, column)
            if not isinstance(value, float) or not self.rows[row].competes:
                continue
            if value != 0 or column.rank_zero:
                texts[row] = column.form(value)
                values.setdefault(texts[row], value)
        order = sorted(values, key=values.__getitem__, reverse=column.better == "higher")
        if len(order) < 2:  # a number with no other to compare with has no rank
            return {}
        places = dict(zip(order[:2], ("best", "second"), strict=True))
        return {row: places[text] for row, text in texts.items() if text in places}

    @cached_property
    def reasons(self) -> list[str]:
        """All distinct reasons. A cell refers to a reason by its number, counted from 1."""
        found = (reason for row in self.rows for reason in self._reasons(row).values())
        return list(dict.fromkeys(found))

    @property
    def notes(self) -> list[str]:
        """The remarks and the numbered reasons."""
        return [*self.remarks, *(f"[{k}] {why}" for k, why in enumerate(self.reasons, start=1))]

    @cached_property
    def groups(self) -> dict[str, list[int]]:
        """Group -> indices of its rows."""
        groups: dict[str, list[int]] = {}
        for k, row in enumerate(self.rows):
            groups.setdefault(row.group, []).append(k)
        return groups

    def value(self, row: int, column: Column) -> float | str | None:
        """The value of a cell; None if it is missing."""
        return _known(self.rows[row].values.get(column.key))

    def has_paper(self, column: Column) -> bool:
        """Whether any row has a number from the paper in the column."""
        return any(column.key in row.paper for row in self.rows)

    def heading(self, column: Column) -> str:
        """A column's heading: title, arrow, and whether the cells have the paper's numbers."""
        return column.title + column.arrow + (" (paper)" if self.has_paper(column) else "")

    def cell(self, row: int, column: Column) -> tuple[str, str, str]:
        """The value, the paper's value and the number of the reason, as text; each may be empty."""
        line = self.rows[row]
        value, paper = self.value(row, column), line.paper.get(column.key)
        text = MISSING if value is None else value if isinstance(value, str) else column.form(value)
        reason = self._reasons(line).get(column.key)
        number = str(self.reasons.index(reason) + 1) if reason else ""
        return text, "" if paper is None else column.form(paper), number

    def label_of(self, row: int) -> tuple[str, str]:
        """A row's label, and the number of the reason why the whole row is missing (or ``""``)."""
        reason = self._reasons(self.rows[row]).get("")
        return self.rows[row].label, str(self.reasons.index(reason) + 1) if reason else ""

    def _reasons(self, row: Row) -> dict[str, str]:
        """The reasons for missing values, by column key; under "" if all share one reason."""
        absent = [c.key for c in self.columns if _known(row.values.get(c.key)) is None]
        if "" in row.reasons and absent:
            return {"": row.reasons[""]}
        return {key: row.reasons.get(key, "not measured") for key in absent}


def _known(value: Value) -> Value:
    """A number as a float, None for NaN; text as it is."""
    if value is None or isinstance(value, str):
        return value
    return None if pd.isna(value) else float(value)
