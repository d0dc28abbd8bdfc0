"""Where pybullet_data has the Panda's URDF and meshes, for every engine that is given them; shapes made of them are geometry.py's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pybullet_data
from jaxtyping import Float


def panda_urdf() -> Path:
    """The Panda's URDF."""
    return _folder() / "panda.urdf"


def collision_mesh(link: str) -> Path:
    """File of the collision mesh of `link0` to `link7`, `hand` or `finger`."""
    return _folder() / "meshes" / "collision" / f"{link}.obj"


def collision_vertices(link: str) -> Float[np.ndarray, "v 3"]:
    """Vertices of that mesh in the order of the file, link frame, metres."""
    lines = collision_mesh(link).read_text().splitlines()
    return np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=np.float64)


def _folder() -> Path:
    return Path(pybullet_data.getDataPath()) / "franka_panda"
