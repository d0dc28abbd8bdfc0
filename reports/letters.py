"""Compact letter display: which of several policies differ, as a letter or more beside each (Piepho, J. Comput. Graph. Stat. 13, 2004).

Two policies share a letter exactly where their difference is not significant.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from itertools import combinations

_ALPHABET = "abcdefghijklmnopqrstuvwxyz"


def letter_groups(names: Sequence[str], differing: Collection[frozenset[str]]) -> list[frozenset[str]]:
    """The groups behind the letters, by insert and absorb: the largest sets of policies of which no two differ.

    Args:
        names: of the policies, in the order of the display; a group whose first member stands above that of another comes first.
        differing: pairs that differ significantly.

    Raises:
        ValueError: a repeated name, or a pair that is not of two of them.
    """
    if len(set(names)) != len(names):
        raise ValueError(f"names {list(names)}, must not repeat")
    strange = sorted(str(sorted(pair)) for pair in differing if len(pair) != 2 or not pair <= set(names))
    if strange:
        raise ValueError(f"pair {strange[0]}, must be two of {list(names)}")
    groups = [frozenset(names)] if names else []
    for pair in (frozenset(both) for both in combinations(names, 2)):
        if pair in differing:
            # Insert: a group that holds both becomes two that hold one each.
            apart = [part for group in groups for part in ([group - {name} for name in pair] if pair <= group else [group])]
            groups = _absorbed(apart)
    place = {name: k for k, name in enumerate(names)}
    return sorted(groups, key=lambda group: sorted(place[name] for name in group))


def letter_display(names: Sequence[str], differing: Collection[frozenset[str]]) -> dict[str, str]:
    """Letters by name, `a` for the first group; raises as `letter_groups` does."""
    groups = letter_groups(names, differing)
    between = "" if len(groups) <= len(_ALPHABET) else " "
    return {name: between.join(_letter(k) for k, group in enumerate(groups) if name in group) for name in names}


def _absorbed(groups: Iterable[frozenset[str]]) -> list[frozenset[str]]:
    """Without repeats and without groups that lie within another."""
    distinct = list(dict.fromkeys(groups))
    return [group for group in distinct if not any(group < other for other in distinct)]


def _letter(number: int) -> str:
    """a to z, then aa, ab and on."""
    return _ALPHABET[number] if number < 26 else _letter(number // 26 - 1) + _ALPHABET[number % 26]
