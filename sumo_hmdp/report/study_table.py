"""A table of a report: the numbers for machines (CSV), and what people read (HTML, Markdown)."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd


@dataclass(frozen=True)
class StudyTable:
    """One table.

    Attributes:
        name: of its files.
        caption: what it shows.
        frame: every number as it is; columns end in their unit.
        headings: of what people read; the first column names the row.
        rows: texts, one for each heading.
        note: what a reader must know, empty for nothing.
        links: of the first column, one a row; empty for none.
    """

    name: str
    caption: str
    frame: pd.DataFrame
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    links: tuple[str, ...] = ()

    def csv(self) -> str:
        """Return the numbers as CSV; missing ones are empty, infinite ones `inf`."""
        return str(self.frame.to_csv(index=False, lineterminator="\n"))

    def markdown(self) -> str:
        """Return what people read as Markdown."""
        lines = [f"**{self.caption}**", ""]
        if self.rows:
            lines += [_line(self.headings), _line(["---"] * len(self.headings)), *map(_line, self.rows)]
        else:
            lines.append("None.")
        return "\n".join([*lines, *(["", self.note] if self.note else [])]) + "\n"


def _line(texts: Sequence[str]) -> str:
    return "| " + " | ".join(text.replace("|", r"\|").replace("\n", " ") for text in texts) + " |"


def number(value: object, digits: int = 3) -> str:
    """Return a number with significant digits; a missing one is a dash, an infinite one is told."""
    if value is None or value is pd.NA:
        return "–"  # noqa: RUF001 - the dash of tables
    number = float(value)  # type: ignore[arg-type]
    if math.isnan(number):
        return "–"  # noqa: RUF001
    if math.isinf(number):
        return "inf" if number > 0 else "−inf"  # noqa: RUF001 - a minus
    whole = number == int(number) or abs(number) >= 10**digits
    text = f"{abs(number):.0f}" if whole else f"{abs(number):.{digits}g}"
    return f"−{text}" if number < 0 else text  # noqa: RUF001 - a minus


def each(frame: pd.DataFrame) -> Iterable[Any]:
    """Return the rows of a table, each with its columns as attributes."""
    return frame.itertuples(index=False)


def printed(unit: str) -> str:
    """Return a unit as people write it."""
    return unit.translate({ord("2"): "²", ord("3"): "³"})


def interval(low: object, high: object, digits: int = 3) -> str:
    """Return an interval in words; a dash where there is none."""
    ends = number(low, digits), number(high, digits)
    return "–" if "–" in ends else f"{ends[0]} to {ends[1]}"  # noqa: RUF001


def p_text(value: float) -> str:
    """Return a p-value."""
    return "< 0.001" if value < 0.001 else number(value, 2)


def listed(names: Sequence[str], most: int = 6) -> str:
    """Return names in a sentence; of more than `most` the rest is counted."""
    shown = list(names[:most])
    if len(names) > most:
        shown.append(f"{len(names) - most} more")
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}" if shown else "none"
