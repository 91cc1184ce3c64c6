"""Tables of a report, in Markdown and in HTML from the same cells."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """A table of text.

    The first `names` columns are words, the others numbers. `note` is a paragraph that says what was measured; `marked`
    are the numbers of rows to set off.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    names: int = 1
    marked: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.header):
                raise ValueError(f"{self.title}: a row of {len(row)} cells under a header of {len(self.header)}")

    def markdown(self) -> str:
        """The table in Markdown with its title and its note."""
        lines = [f"**{self.title}**", ""]
        if self.note:
            lines += [self.note, ""]
        lines.append(_row(self.header))
        lines.append("|" + "".join("---|" if i < self.names else "--:|" for i in range(len(self.header))))
        lines += [_row(row) for row in self.rows]
        return "\n".join(lines) + "\n"

    def html(self) -> str:
        """The table in HTML with its title and its note."""
        kinds = ["w" if i < self.names else "n" for i in range(len(self.header))]
        head = "".join(f'<th class="{k}">{html.escape(c)}</th>' for k, c in zip(kinds, self.header, strict=True))
        body = "".join(
            ('<tr class="m">' if number in self.marked else "<tr>")
            + "".join(f'<td class="{k}">{html.escape(c)}</td>' for k, c in zip(kinds, row, strict=True))
            + "</tr>\n"
            for number, row in enumerate(self.rows)
        )
        note = f"<p>{html.escape(self.note)}</p>\n" if self.note else ""
        table = f'<div class="t"><table>\n<tr>{head}</tr>\n{body}</table></div>\n'
        return f"<h3>{html.escape(self.title)}</h3>\n{note}{table}"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |"


def decibel(value: float | None) -> str:
    """A PSNR for a table."""
    return "–" if value is None else f"{value:.1f}"


def percent(value: float | None) -> str:
    """A part as per cent with three digits or two places, whichever is shorter."""
    if value is None:
        return "–"
    number = 100.0 * value
    return f"{number:.2f} %" if number < 10.0 else f"{number:.1f} %" if number < 100.0 else f"{number:.0f} %"


def ratio(median: float, low: float | None = None, high: float | None = None) -> str:
    """A ratio for a table, with its quartiles where they are given."""

    def short(value: float) -> str:
        return f"{value:.2f}" if value < 10.0 else f"{value:.1f}" if value < 100.0 else f"{value:.0f}"

    text = f"{short(median)}×"
    return text if low is None or high is None else f"{text} ({short(low)}–{short(high)})"
