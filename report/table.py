"""A table: rows of numbers, the paper's beside ours, the best of each column, and reasons.

Every way of writing it starts from one :attr:`Table.frame`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import pandas as pd

from gpf.core.files import write_text
from report.formats import Form
from report.writing import to_html, to_latex, to_markdown

Value = float | str | None

MISSING = "–"
"""What stands where there is no number."""


@dataclass(frozen=True)
class Column:
    """What the cells of a column are.

    Attributes
    ----------
    key: its name in the frame and in CSV.
    title: its name for people.
    form: how a number is written; text is written as it is.
    better: which numbers win; "" where none does.
    nothing_wins: whether 0 takes part, as a file of no bytes would.
    """

    key: str
    title: str
    form: Form = str
    better: Literal["higher", "lower", ""] = ""
    nothing_wins: bool = True

    @property
    def arrow(self) -> str:
        """Which way is better."""
        return {"higher": " ↑", "lower": " ↓", "": ""}[self.better]


@dataclass(frozen=True)
class Row:
    """A line of a table.

    Attributes
    ----------
    values, paper: ours and the paper's, by the columns' keys; what is unknown is left out or NaN.
    group: rows of one group stand together and compete with each other alone.
    reasons: why a value is missing, by key; by "" for all of them.
    competes: whether it can be best.
    ours: whether it is the field's.
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
    """A table for people and programs.

    Attributes
    ----------
    name: of its files.
    title, caption: what it shows, and how to read it.
    label: the heading of the rows' labels.
    grouped_by: the heading of their groups; "" without groups.
    remarks: what else there is to know; reasons of missing numbers follow them in :attr:`notes`.
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
        """Group, label, and of each column ours, the paper's if any row has one
        (``psnr_paper``), and its place where the column has a best (``psnr_rank``: 1, 2 or none);
        at last the ``reason`` of what is missing. Numbers are as measured."""
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
        """For each row and column's key ``"best"``, ``"second"`` or ``""``.

        Numbers that read the same share their place.
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
        """The best and second best of these rows."""
        worth: dict[str, float] = {}
        texts: dict[int, str] = {}
        for row in rows:
            value = self.value(row, column)
            zero_out = value == 0 and not column.nothing_wins
            if self.rows[row].competes and isinstance(value, float) and not zero_out:
                texts[row] = column.form(value)
                worth.setdefault(texts[row], value)
        order = sorted(worth, key=worth.__getitem__, reverse=column.better == "higher")
        if len(order) < 2:  # who is alone has beaten nobody
            return {}
        places = dict(zip(order[:2], ("best", "second"), strict=True))
        return {row: places[text] for row, text in texts.items() if text in places}

    @cached_property
    def reasons(self) -> list[str]:
        """Each reason once; a cell refers to it by its number, from 1."""
        found = (reason for row in self.rows for reason in self._reasons(row).values())
        return list(dict.fromkeys(found))

    @property
    def notes(self) -> list[str]:
        """The remarks, then the numbered reasons."""
        return [*self.remarks, *(f"[{k}] {why}" for k, why in enumerate(self.reasons, start=1))]

    @cached_property
    def groups(self) -> dict[str, list[int]]:
        """Group -> the numbers of its rows."""
        groups: dict[str, list[int]] = {}
        for k, row in enumerate(self.rows):
            groups.setdefault(row.group, []).append(k)
        return groups

    def value(self, row: int, column: Column) -> float | str | None:
        """What a cell holds; None where it is missing."""
        return _known(self.rows[row].values.get(column.key))

    def has_paper(self, column: Column) -> bool:
        """Whether the paper has a number for any cell of the column."""
        return any(column.key in row.paper for row in self.rows)

    def heading(self, column: Column) -> str:
        """A column's name for people, with its direction and what stands in brackets."""
        return column.title + column.arrow + (" (paper)" if self.has_paper(column) else "")

    def cell(self, row: int, column: Column) -> tuple[str, str, str]:
        """Ours and the paper's (or ``""``) as text, and the number of the reason (or ``""``)."""
        line = self.rows[row]
        value, paper = self.value(row, column), line.paper.get(column.key)
        text = MISSING if value is None else value if isinstance(value, str) else column.form(value)
        reason = self._reasons(line).get(column.key)
        number = str(self.reasons.index(reason) + 1) if reason else ""
        return text, "" if paper is None else column.form(paper), number

    def label_of(self, row: int) -> tuple[str, str]:
        """A row's label, and the number of the reason that all its numbers are missing."""
        reason = self._reasons(self.rows[row]).get("")
        return self.rows[row].label, str(self.reasons.index(reason) + 1) if reason else ""

    def _reasons(self, row: Row) -> dict[str, str]:
        """Reasons by key, as far as something is missing; "" stands for all that is."""
        absent = [c.key for c in self.columns if _known(row.values.get(c.key)) is None]
        if "" in row.reasons and absent:
            return {"": row.reasons[""]}
        return {key: row.reasons.get(key, "not measured") for key in absent}

    def to_csv(self) -> str:
        """For programs: :attr:`frame`."""
        return self.frame.to_csv(index=False)

    def to_markdown(self) -> str:
        """For a README."""
        return to_markdown(self)

    def to_latex(self) -> str:
        """For a paper, with the package booktabs."""
        return to_latex(self)

    def to_html(self) -> str:
        """For a page: a figure with the table and its notes, but not its title."""
        return to_html(self)

    def write(self, folder: Path) -> list[Path]:
        """Write all four into a folder."""
        texts = {
            ".csv": self.to_csv(),
            ".md": self.to_markdown(),
            ".tex": self.to_latex(),
            ".html": self.to_html(),
        }
        for suffix, text in texts.items():
            write_text(folder / (self.name + suffix), text)
        return [folder / (self.name + suffix) for suffix in texts]


def _known(value: Value) -> Value:
    """A number as a float; nothing in place of NaN."""
    if value is None or isinstance(value, str):
        return value
    return None if pd.isna(value) else float(value)
