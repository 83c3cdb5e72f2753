"""One table per benchmark: printed as text, kept as JSON."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

Cell = str | float | int | None


@dataclass
class Table:
    """Rows of a benchmark, each a dict over `columns`, and the sentences without which they would mislead."""

    name: str
    title: str
    columns: tuple[str, ...]
    rows: list[dict[str, Cell]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, *cells: Cell) -> None:
        """Append a row, one cell per column; None stands for what was not measured."""
        self.rows.append(dict(zip(self.columns, cells, strict=True)))

    def row(self, label: str) -> dict[str, Cell]:
        """The row whose first cell is `label`."""
        return next(row for row in self.rows if row[self.columns[0]] == label)

    def text(self) -> str:
        """The table as aligned text: words to the left, numbers to the right."""
        lines = [[_shown(row[column]) for column in self.columns] for row in self.rows]
        widths = [
            max(len(line[i]) for line in [list(self.columns), *lines])
            for i in range(len(self.columns))
        ]
        words = [all(isinstance(row[column], str) for row in self.rows) for column in self.columns]

        def aligned(cells: list[str]) -> str:
            parts = [
                c.ljust(w) if left else c.rjust(w)
                for c, w, left in zip(cells, widths, words, strict=True)
            ]
            return "  ".join(parts).rstrip()

        head = [
            f"{self.name}: {self.title}",
            "",
            aligned(list(self.columns)),
            "  ".join("-" * w for w in widths),
        ]
        return "\n".join([*head, *map(aligned, lines), *(["", *self.notes] if self.notes else [])])

    def as_json(self) -> dict[str, Any]:
        """The table for a JSON file."""
        return {
            "title": self.title,
            "columns": list(self.columns),
            "rows": self.rows,
            "notes": self.notes,
        }


def _shown(cell: Cell) -> str:
    """Four significant digits, whole from 1000 on with commas; a dash for what was not measured."""
    if cell is None:
        return "-"
    if isinstance(cell, str):
        return cell
    if isinstance(cell, int) or abs(cell) >= 1000:
        return f"{cell:,.0f}"
    return f"{cell:#.3g}".rstrip(".")
