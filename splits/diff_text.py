"""The difference of two releases in Markdown, and the command that prints it; what differs is found in diff.py."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown

from splits.diff import ReleaseDiff, Step, TableDiff, diff_releases
from splits.errors import ReleaseError
from splits.markdown import count, table
from tables.schemas import ALL_SCHEMAS

EQUAL, DIFFERENT, ERROR = 0, 1, 2
EXIT_STATUS = "exit status: 0 where the releases are equal in content, 1 where they differ, 2 on an error"

_N_SHOWN = 12  # of the digits of a hash, and of the flips of a column
_HASH = re.compile(r"[0-9a-f]{40,64}")


def print_diff(a: Path, b: Path) -> int:
    """Print what changed from release A to release B; returns the exit status, see `EXIT_STATUS`."""
    try:
        diff = diff_releases(a, b)
    except ReleaseError as error:
        print(f"cannot be compared: {error}", file=sys.stderr)
        return ERROR
    text = rendered(diff)
    if sys.stdout.isatty():
        Console().print(Markdown(text))
    else:
        print(text, end="")
    return DIFFERENT if diff.asked >= Step.MINOR else EQUAL


def rendered(diff: ReleaseDiff) -> str:
    """The whole difference as Markdown: verdict, what the manifests say, tables, and of each changed table its columns and labels."""
    blocks = [f"# From {diff.a} (A) to {diff.b} (B)", _verdict(diff)]
    if diff.facts:
        facts = [[name, _shortened(old), _shortened(new)] for name, old, new in diff.facts]
        blocks += ["## What the manifests say", table(["", "A", "B"], facts, align="lll")]
    blocks += ["## Tables", _tables(diff)]
    blocks += [block for own in diff.tables if own.content is not None for block in _table_section(own)]
    return "\n\n".join(blocks) + "\n"


def _verdict(diff: ReleaseDiff) -> str:
    reasons = diff.reasons()
    if not reasons:
        return f"Nothing differs. Version {diff.version_a} in A, {diff.version_b} in B."
    equal = "Equal in content. " if diff.asked < Step.MINOR else ""
    versions = f"B is {diff.version_b} after {diff.version_a}"
    fits = (
        f"{versions}, which fits." if diff.version_fits else f"{versions}, **which does not fit: must be at least {diff.least_version}**."
    )
    before_1 = " Before 1.0 the second number stands for MAJOR." if diff.asked is Step.MAJOR and diff.least_version.startswith("0.") else ""
    why = []
    for asked in sorted(Step, reverse=True):
        found = [what for step, what in reasons if step is asked]
        why += [f"- {asked.name}: {'; '.join(found)}"] if found else []
    return "\n\n".join([f"{equal}The difference asks for a **{diff.asked.name}** step; {fits}{before_1}", "\n".join(why)])


def _tables(diff: ReleaseDiff) -> str:
    rows = []
    for own in diff.tables:
        content = own.content
        counts = [None] * 3 if content is None else [count(n) for n in (content.added, content.removed, content.changed)]
        lacking = f", not in the folder of {' and '.join(own.lacking)}" if own.lacking else ""
        rows.append([f"`{own.name}`", f"{own.state.value}{lacking}", *(_count(n) for n in (own.rows_a, own.rows_b)), *counts])
    return table(["table", "", "rows in A", "in B", "added", "removed", "changed"], rows, align="llrrrrr")


def _table_section(own: TableDiff) -> list[str]:
    """What happened in one changed table."""
    content = own.content
    assert content is not None
    blocks = [f"## `{own.name}`"]
    firsts = (("added", content.first_added), ("removed", content.first_removed), ("changed", content.first_changed))
    if any(key for _, key in firsts):
        keys = ", ".join(ALL_SCHEMAS[own.name].key)
        blocks.append(f"First by {keys}: {'; '.join(f'{what} {key}' for what, key in firsts if key)}.")
    columns = (("New", content.new_columns), ("Removed", content.lost_columns), ("Of another type", content.retyped_columns))
    blocks += [f"{what} columns: {', '.join(names)}." for what, names in columns if names]
    if content.columns:
        rows = [
            [f"`{change.name}`", count(change.rows), None if change.largest is None else f"{change.largest:.3g} {change.unit}".rstrip()]
            for change in content.columns
        ]
        blocks.append(table(["column", "rows changed", "largest change"], rows))
    flips = [
        [f"`{change.name}`", old, new, count(n)]
        for change in content.columns
        for old, new, n in (*change.flips[:_N_SHOWN], *_rest(change.flips))
    ]
    if flips:
        blocks.append(table(["moved" if own.name == "splits" else "label", "from", "to", "rows"], flips, align="lllr"))
    return blocks


def _rest(flips: tuple[tuple[str, str, int], ...]) -> list[tuple[str, str, int]]:
    """The rare flips in one row."""
    rare = flips[_N_SHOWN:]
    return [(f"{len(rare)} other pairs", "", sum(n for _, _, n in rare))] if rare else []


def _count(n: int | None) -> str | None:
    return None if n is None else count(n)


def _shortened(value: str | None) -> str | None:
    """Hashes by their first digits."""
    return None if value is None else _HASH.sub(lambda match: match[0][:_N_SHOWN], value)
