"""Letters say exactly which pairs differ, with the groups that a search through all subsets finds."""

from __future__ import annotations

from itertools import chain, combinations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reports.letters import letter_display, letter_groups

Pairs = set[frozenset[str]]


@st.composite
def displays(draw: st.DrawFn) -> tuple[list[str], Pairs]:
    """Some policies and any pairs of them."""
    names = [f"p{k}" for k in range(draw(st.integers(0, 7)))]
    pairs = [frozenset(pair) for pair in combinations(names, 2)]
    return names, set(draw(st.lists(st.sampled_from(pairs), unique=True))) if pairs else set()


def largest_alike(names: list[str], differing: Pairs) -> set[frozenset[str]]:
    """Every subset of which no two differ and that no other such subset holds, by trying all of them."""
    subsets = chain.from_iterable(combinations(names, n) for n in range(1, len(names) + 1))
    alike = [frozenset(own) for own in subsets if not any(frozenset(pair) in differing for pair in combinations(own, 2))]
    return {own for own in alike if not any(own < other for other in alike)}


@given(displays())
@settings(max_examples=300, deadline=None)
def test_the_groups_are_the_largest_of_which_no_two_differ(display: tuple[list[str], Pairs]) -> None:
    names, differing = display
    groups = letter_groups(names, differing)
    assert len(groups) == len(set(groups))
    assert set(groups) == largest_alike(names, differing)


@given(displays())
@settings(max_examples=200, deadline=None)
def test_two_share_a_letter_exactly_where_they_do_not_differ(display: tuple[list[str], Pairs]) -> None:
    names, differing = display
    letters = letter_display(names, differing)
    assert list(letters) == names
    assert all(letters.values())
    for pair in combinations(names, 2):
        assert bool(set(letters[pair[0]]) & set(letters[pair[1]])) == (frozenset(pair) not in differing)


def test_piephos_example_of_neighbours() -> None:
    """Six in a row of which only neighbours are alike: five letters, each for two."""
    names = ["a", "b", "c", "d", "e", "f"]
    differing = {frozenset((names[i], names[j])) for i in range(6) for j in range(i + 2, 6)}
    assert letter_display(names, differing) == {"a": "a", "b": "ab", "c": "bc", "d": "cd", "e": "de", "f": "e"}


def test_letters_begin_with_the_best() -> None:
    apart = {frozenset(("good", "bad")), frozenset(("good", "worse")), frozenset(("fair", "worse"))}
    assert letter_display(["good", "fair", "bad", "worse"], apart) == {"good": "a", "fair": "ab", "bad": "bc", "worse": "c"}


def test_more_groups_than_letters_are_told_apart() -> None:
    names = [f"p{k:02d}" for k in range(30)]
    letters = letter_display(names, {frozenset(pair) for pair in combinations(names, 2)})
    assert letters["p00"] == "a"
    assert letters["p26"] == "aa"
    assert len(set(letters.values())) == 30


def test_what_is_no_pair_of_them_is_refused() -> None:
    with pytest.raises(ValueError, match="must be two of"):
        letter_groups(["a", "b"], {frozenset(("a", "c"))})
    with pytest.raises(ValueError, match="must not repeat"):
        letter_groups(["a", "a"], set())
