"""Hypothesis strategies that several rooms share."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from tables.poses import matrix_of


def unit_quaternions() -> st.SearchStrategy[np.ndarray]:
    """Quaternions xyzw of length 1, any sign."""
    number = st.floats(-1.0, 1.0, allow_subnormal=False)
    four = st.tuples(number, number, number, number).map(np.array)
    return four.filter(lambda q: np.linalg.norm(q) > 1e-2).map(lambda q: q / np.linalg.norm(q))


def transforms(reach_m: float = 2.0) -> st.SearchStrategy[np.ndarray]:
    """4x4 rigid transforms with a translation within `reach_m`."""
    number = st.floats(-reach_m, reach_m, allow_subnormal=False)
    return st.tuples(st.tuples(number, number, number), unit_quaternions()).map(lambda tq: matrix_of(np.array([*tq[0], *tq[1]])))
