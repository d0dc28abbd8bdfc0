"""When has an object come to rest? One question and one answer for every engine; motions of the hand are hand_rollout.py."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from jaxtyping import Float

from pipelines.engines.physics.phases import Phase, Watch, no_watch, pose_difference


class RestParams(Protocol):
    """The numbers of an engine that say what rest is."""

    @property
    def dt_s(self) -> float: ...
    @property
    def check_every_steps(self) -> int: ...
    @property
    def settled_speed_m_s(self) -> float: ...
    @property
    def settled_rate_rad_s(self) -> float: ...
    @property
    def settled_checks(self) -> int: ...


class SteppedWorld(Protocol):
    """A world in which time passes in steps of `params.dt_s`."""

    @property
    def params(self) -> RestParams: ...
    def step(self) -> None: ...
    def object_pose(self) -> Float[np.ndarray, "4 4"]: ...


class RestWatch:
    """Tells whether the object has come to rest, asked every `check_every_steps` steps.

    Speeds are means from one check to the next: an object that only trembles, some micrometres to and fro at every step as lying
    hulls do in Bullet, is at rest although its speed at any moment is not 0.
    """

    def __init__(self, world: SteppedWorld) -> None:
        self._world = world
        self._before = world.object_pose()
        self._n_quiet = 0

    def is_at_rest(self) -> bool:
        """Whether this check and enough checks before it in a row found the object below both speed bounds."""
        params, now = self._world.params, self._world.object_pose()
        seconds = params.check_every_steps * params.dt_s
        moved_m, turned_rad = pose_difference(self._before, now)
        is_quiet = moved_m < params.settled_speed_m_s * seconds and turned_rad < params.settled_rate_rad_s * seconds
        self._before, self._n_quiet = now, self._n_quiet + 1 if is_quiet else 0
        return self._n_quiet >= params.settled_checks


def settle(world: SteppedWorld, max_steps: int, watch: Watch = no_watch) -> bool:
    """Step until the object is at rest in enough checks in a row; False where it still moves after `max_steps`."""
    rest = RestWatch(world)
    for k in range(1, max_steps + 1):
        world.step()
        if k % world.params.check_every_steps == 0:
            watch(Phase.SETTLE)
            if rest.is_at_rest():
                return True
    return False


def n_steps_of(world: SteppedWorld, duration_s: float) -> int:
    """Whole steps in a duration, at least one."""
    return max(1, round(duration_s / world.params.dt_s))
