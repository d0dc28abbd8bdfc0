"""Writes the golden table of the packaged catalogue: volume, centre of mass and resting poses of each object, rounded.

    python -m tests.objects.golden.regenerate

A changed golden means that the benchmark's objects changed: say so in the changelog of the data.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from objects.catalogue import load_catalogue
from objects.solids import solid_of
from objects.stable_poses import StablePoseParams, stable_poses

GOLDEN = Path(__file__).with_name("catalogue.json")


def table() -> dict[str, Any]:
    """One entry an object; millilitres, millimetres, percent."""
    rows: dict[str, Any] = {}
    for spec in load_catalogue():
        mesh = solid_of(spec).mesh
        com_m = np.asarray(mesh.center_mass) + np.array(spec.com_offset_m)
        poses = stable_poses(spec, mesh, com_m, StablePoseParams())
        rows[spec.object_id] = {
            "volume_ml": round(float(mesh.volume) * 1e6, 1),
            "com_mm": [round(float(v) * 1e3, 1) + 0.0 for v in com_m],
            "rests_percent": {pose.resting: round(pose.probability * 100, 1) for pose in sorted(poses, key=lambda pose: pose.resting)},
        }
    return rows


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps(table(), indent=1) + "\n", encoding="utf-8")
