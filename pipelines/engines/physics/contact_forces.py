"""Contact forces of every step of a tick, read back after it from the sensors' histories; the sensors are hand_model.py's."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

from pipelines.engines.physics.hand_bodies import HAND_PARTS
from pipelines.engines.physics.hand_model import SceneModel


class ContactForces:
    """Reads the force sensors of one model.

    Attributes:
        pairs: whom the rows of `sums` are between, "robot" and "anything" last where there is a hand.
    """

    def __init__(self, scene: SceneModel, n_steps: int) -> None:
        model = scene.model
        kept = [name for name, k in scene.sensor_adr.items() if model.sensor_history[k, 0] > 0]
        self.pairs = [(name.split(" ", 1)[0], name.split(" ", 1)[1]) for name in kept]
        # A history is [user, cursor, n times, n values]; a tick fills its ring exactly, so its order is the same at every tick's end.
        starts = np.array([model.sensor_historyadr[scene.sensor_adr[name]] + 2 + n_steps for name in kept], dtype=np.int64)
        self._pair_at = {name: int(model.sensor_adr[scene.sensor_adr[name]]) for name in kept}
        self._history = starts[:, None, None] + np.arange(n_steps)[:, None] * 3 + np.arange(3)
        at = [int(model.sensor_adr[scene.sensor_adr[name]]) for name in HAND_PARTS if name in scene.sensor_adr]
        self._parts = {name: slice(k, k + 3) for name, k in zip(HAND_PARTS, at, strict=False)}
        self._any_part = np.array(at, dtype=np.int64)[:, None] + np.arange(3)

    def sums_n(self, data: mujoco.MjData) -> list[float]:
        """Sizes of the net force between each pair, summed over the tick's steps."""
        forces: Float[np.ndarray, "s n 3"] = data.history[self._history]
        sums: list[float] = np.sqrt(np.einsum("snk,snk->sn", forces, forces)).sum(axis=1).tolist()
        return sums

    def presses(self, data: mujoco.MjData, part: str) -> bool:
        """Whether a part of the hand pressed on the object in the last step."""
        return part in self._parts and bool(data.sensordata[self._parts[part]].any())

    def is_touched(self, data: mujoco.MjData) -> bool:
        """Whether any part of the hand did."""
        return bool(data.sensordata[self._any_part].any())

    def last_n(self, data: mujoco.MjData, body: str, other: str) -> float:
        """Size of the last step's net force: of "object" or "robot" with table or an obstacle, or of the whole hand with the object."""
        if (body, other) == ("robot", "object"):
            return float(sum(np.linalg.norm(data.sensordata[at]) for at in self._parts.values()))
        at = self._pair_at.get(f"{body} {other}")
        return 0.0 if at is None else float(np.linalg.norm(data.sensordata[at : at + 3]))
