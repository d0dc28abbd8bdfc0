"""Motions of a hand world: follow a trajectory, hold, close, open, and watch what happens; verdicts are the stages'."""

from __future__ import annotations

import numpy as np

from pipelines.engines.physics.coming_to_rest import n_steps_of
from pipelines.engines.physics.hand_bodies import FINGERS
from pipelines.engines.physics.hand_motion import hand_motion
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.phases import Phase, Watch, no_watch
from pipelines.engines.planning.trajectory import Trajectory


def move(world: HandWorld, phase: Phase, trajectory: Trajectory, watch: Watch = no_watch) -> bool:
    """Follow a trajectory, one sample a tick; False where the watch, a lost object or a protective stop ended it."""
    if world.is_lost or world.is_stopped:
        return False
    motion = hand_motion(trajectory, world.params.dt_s)
    world.begin_motion(motion)
    every = world.params.check_every_steps
    for k, q in enumerate(np.asarray(trajectory.q_rad[1:])):
        world.step_along(motion, k, q)
        if world.is_lost or world.is_stopped or ((k + 1) % every == 0 and watch(phase)):
            return False
    return not watch(phase)


def hold(world: HandWorld, phase: Phase, duration_s: float, watch: Watch = no_watch) -> bool:
    """Let a duration pass under the present commands; False where the watch, a lost object or a protective stop ended it."""
    for k in range(1, n_steps_of(world, duration_s) + 1):
        if world.is_lost or world.is_stopped:
            return False
        world.step()
        if k % world.params.check_every_steps == 0 and watch(phase):
            return False
    return True


def close_fingers(world: HandWorld, max_s: float, watch: Watch = no_watch) -> bool:
    """Close until both fingers press on the object in two checks in a row, and go on pressing; False where they never do."""
    if world.is_lost or world.is_stopped:
        return False
    world.grip()
    n_pressing = 0
    for k in range(1, n_steps_of(world, max_s) + 1):
        world.step()
        if k % world.params.check_every_steps == 0:
            n_pressing = n_pressing + 1 if pressing_fingers(world) == 2 else 0
            if world.is_stopped or watch(Phase.CLOSE):
                return False
            if n_pressing >= 2:
                return True
    return False


def open_fingers(world: HandWorld, jaw_m: float, max_s: float, watch: Watch = no_watch) -> bool:
    """Open both fingers to half of `jaw_m` each and stop there; False where something kept them from it."""
    if world.is_lost or world.is_stopped:
        return False
    world.command_fingers(world.params.finger_speed_m_s)
    for k in range(1, n_steps_of(world, max_s) + 1):
        world.step()
        # At 0.05 m/s a finger moves 0.2 mm a tick.
        if world.arm_state()[1].min() >= jaw_m / 2 - 1e-4:
            world.command_fingers(0.0)
            return True
        if world.is_stopped or (k % world.params.check_every_steps == 0 and watch(Phase.OPEN)):
            break
    world.command_fingers(0.0)
    return False


def pressing_fingers(world: HandWorld) -> int:
    """Number of fingers that press on the object: 0, 1 or 2."""
    return sum(world.touching(finger) for finger in FINGERS) if world.has_robot else 0
