"""A strip tells an execution: its start, the end of each phase, and most of where most moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipelines.engines.physics.phases import Phase
from pipelines.pictures.filmstrip import telling_moments
from pipelines.pictures.recording import Moment


def moments(phases: Sequence[Phase], turned_rad: Sequence[float]) -> list[Moment]:
    return [
        Moment(phase, 0.1 * k, np.full(7, q), np.zeros(2), np.eye(4), 0.0, 0.0)
        for k, (phase, q) in enumerate(zip(phases, turned_rad, strict=True))
    ]


@given(st.lists(st.tuples(st.sampled_from(list(Phase)[:3]), st.floats(-3, 3)), min_size=1, max_size=30), st.integers(2, 12))
def test_what_is_chosen_is_in_order_with_both_ends(made: list[tuple[Phase, float]], n: int) -> None:
    own = moments([phase for phase, _ in made], [q for _, q in made])
    chosen = telling_moments(own, n)
    assert chosen == sorted(set(chosen))
    assert (chosen[0], chosen[-1]) == (0, len(own) - 1)
    assert len(chosen) == min(n, len(own))


def test_every_phase_ends_in_a_picture_and_the_rest_is_where_the_arm_turns() -> None:
    first, second, third = list(Phase)[:3]
    own = moments([first] * 5 + [second] * 9 + [third] * 6, [0.0] * 5 + [0.25 * k for k in range(9)] + [2.0] * 6)
    assert telling_moments(own, 4) == [0, 4, 13, 19]
    assert telling_moments(own, 5) == [0, 4, 9, 13, 19]
    assert telling_moments(own, 3) == [0, 13, 19]
