"""Markdown tables and numbers as people read them, for the data card and the reports."""

from __future__ import annotations

from collections.abc import Sequence

MISSING = "–"


def table(header: Sequence[str | None], rows: Sequence[Sequence[object]], *, align: str = "") -> str:
    """A GitHub table; bars in cells are escaped.

    Args:
        header: column titles.
        rows: cells, shown by `str`; None as a dash.
        align: one letter a column, `l` or `r`; the first column left and the others right by default.
    """
    align = align or "l" + "r" * (len(header) - 1)
    if len(align) != len(header) or any(len(row) != len(header) for row in rows):
        raise ValueError(f"table of {len(header)} columns: alignments {len(align)}, row lengths {sorted({len(row) for row in rows})}")
    lines: list[Sequence[object]] = [list(header), ["---:" if letter == "r" else "---" for letter in align], *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)


def count(n: int) -> str:
    """`153,072`."""
    return f"{n:,}"


def percent(share: float | None, digits: int = 1) -> str:
    """`61.3 %` of a share in [0, 1]; a dash for None."""
    return MISSING if share is None else f"{100.0 * share:.{digits}f} %"


def share(part: int, whole: int, digits: int = 1) -> str:
    """`12 (34.3 %)`; without the share where the part is 0."""
    return f"{part:,} ({percent(part / whole, digits)})" if part else "0"


def _cell(cell: object) -> str:
    return MISSING if cell is None else str(cell).replace("|", "\\|").replace("\n", " ")
