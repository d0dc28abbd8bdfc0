"""Writes the three meshes of the example catalogue: `python -m objects.examples.make_meshes`; they are ours, under CC0.

Whoever brings meshes of their own needs nothing of this: a file and an entry in a catalogue are enough.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike

FOLDER = Path(__file__).parent
# Radius and height of the outline, from the axis at the foot to the axis at the cap, in metres.
_BOTTLE = ((0.0, 0.0), (0.026, 0.0), (0.028, 0.004), (0.028, 0.095), (0.012, 0.125), (0.012, 0.140), (0.0, 0.140))
# Outlines, counter-clockwise, each from a corner that sees all others.
_BRACKET = ((0.024, 0.024), (0.024, 0.070), (0.0, 0.070), (0.0, 0.0), (0.090, 0.0), (0.090, 0.024))
_WEDGE = ((0.0, 0.0), (0.110, 0.0), (0.110, 0.012), (0.0, 0.055))


def make_meshes() -> dict[str, trimesh.Trimesh]:
    """Watertight meshes in metres by file name: a body of revolution, an L and a wedge, the last two 40 and 45 mm wide."""
    return {
        "bottle.ply": trimesh.creation.revolve(np.array(_BOTTLE), sections=24),
        "bracket.ply": _extruded(_BRACKET, 0.040),
        "wedge.ply": _extruded(_WEDGE, 0.045),
    }


def _extruded(outline: ArrayLike, height_m: float) -> trimesh.Trimesh:
    corners = np.array(outline)
    fan = [(0, k, k + 1) for k in range(1, len(corners) - 1)]
    return trimesh.creation.extrude_triangulation(corners, np.array(fan), height_m)


def main() -> None:
    for name, mesh in make_meshes().items():
        mesh.export(FOLDER / name, vertex_normal=False)


if __name__ == "__main__":
    main()
