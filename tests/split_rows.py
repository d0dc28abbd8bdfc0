"""Rows of table `splits` in which every scheme says the same, for tests that need some table or that are about one scheme."""

from __future__ import annotations

from typing import Any

from tables.vocabulary import SplitScheme


def split_row(scene_id: str, split: str, **others: str) -> dict[str, Any]:
    """The row of a scene; `others` are columns of schemes that say something else."""
    return {"scene_id": scene_id, **{scheme.column: split for scheme in SplitScheme}, **others}
