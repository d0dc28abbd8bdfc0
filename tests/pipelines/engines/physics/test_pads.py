"""Levers of pads: closed forms against brute force, cells against the face they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from pipelines.engines.physics.pads import PAD_SIZE_M, even_pressure_lever_m, pad_cells, winkler_lever_m


@pytest.mark.parametrize("size_m", [PAD_SIZE_M, (0.01, 0.01), (0.001, 0.02)])
def test_even_pressure_lever_is_the_mean_distance(size_m: tuple[float, float]) -> None:
    at = (np.arange(1000) + 0.5) / 1000 - 0.5
    x, z = np.meshgrid(at * size_m[0], at * size_m[1])
    assert even_pressure_lever_m(*size_m) == pytest.approx(float(np.hypot(x, z).mean()), rel=1e-5)


@pytest.mark.parametrize("scale", [0.85, 1.0, 1.15])
@pytest.mark.parametrize("n", [3, 5])
def test_cells_have_the_lever_of_the_face(n: int, scale: float) -> None:
    cells = pad_cells(n, scale)
    lever_m = np.sqrt(np.sum(cells.points_m**2, axis=1) + cells.lever_m**2).mean()
    assert lever_m == pytest.approx(scale * even_pressure_lever_m(*PAD_SIZE_M), rel=1e-9)
    # A cell's own lever is that of its rectangle, which brute force gives, within a fifth: the cone adds squares, the rectangle does not.
    assert cells.lever_m == pytest.approx(scale * even_pressure_lever_m(PAD_SIZE_M[0] / n, PAD_SIZE_M[1] / n), rel=0.2)
    assert (np.abs(cells.points_m).max(axis=0) + cells.radius_m <= np.array(PAD_SIZE_M) / 2 + 1e-12).all()  # no cap stands out
    assert cells.radius_m > 0.0004


def test_a_wide_cylinder_is_a_face_and_a_stiff_pad_a_line() -> None:
    flat = winkler_lever_m(1e4, True, 50.0, 1.3e6)
    assert flat == pytest.approx(even_pressure_lever_m(*PAD_SIZE_M), rel=1e-3)
    line = winkler_lever_m(0.033, True, 50.0, 1.3e10, n=2000)
    assert line == pytest.approx(PAD_SIZE_M[1] / 4, rel=0.02)
