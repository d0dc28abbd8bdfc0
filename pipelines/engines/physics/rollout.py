"""Motions run in a physics world: follow a trajectory, hold, close, open, settle, and watch what happens; stages judge it."""

from __future__ import annotations

from pipelines.engines.physics.coming_to_rest import n_steps_of
from pipelines.engines.physics.phases import Phase, Watch, no_watch
from pipelines.engines.physics.world import FINGER_LINKS, PhysicsWorld
from pipelines.engines.planning.trajectory import Trajectory


def move(world: PhysicsWorld, phase: Phase, trajectory: Trajectory, watch: Watch = no_watch) -> bool:
    """Follow a trajectory from its second sample on, one sample a step; False where the watch ended it."""
    every = world.params.check_every_steps
    commands = zip(trajectory.q_rad[1:].tolist(), trajectory.qd_rad_s[1:].tolist(), strict=True)
    for k, (q, qd) in enumerate(commands, 1):
        world.command_arm(q, qd)
        world.step()
        if k % every == 0 and watch(phase):
            return False
    # The last sample commands zero speed only up to rounding; a held pose must be at rest.
    world.command_arm(trajectory.q_rad[-1].tolist(), [0.0] * 7)
    return not watch(phase)


def hold(world: PhysicsWorld, phase: Phase, duration_s: float, watch: Watch = no_watch) -> bool:
    """Let a duration pass under the present commands; False where the watch ended it."""
    every = world.params.check_every_steps
    for k in range(1, n_steps_of(world, duration_s) + 1):
        world.step()
        if k % every == 0 and watch(phase):
            return False
    return True


def close_fingers(world: PhysicsWorld, max_s: float) -> bool:
    """Close until both fingers press on the object in two checks in a row, then grip; False where they never do."""
    every = world.params.check_every_steps
    world.command_fingers(-world.params.finger_speed_m_s)
    n_pressing = 0
    for k in range(1, n_steps_of(world, max_s) + 1):
        world.step()
        if k % every == 0:
            n_pressing = n_pressing + 1 if pressing_fingers(world) == 2 else 0
            if n_pressing >= 2:
                world.grip()
                return True
    return False


def open_fingers(world: PhysicsWorld, jaw_m: float, max_s: float, watch: Watch = no_watch) -> bool:
    """Open both fingers to half of `jaw_m` each and stop there; False where something kept them from it."""
    every = world.params.check_every_steps
    world.command_fingers(world.params.finger_speed_m_s)
    for k in range(1, n_steps_of(world, max_s) + 1):
        world.step()
        # At 0.1 m/s a finger moves 0.4 mm a step: looking every other step overshoots by less than a millimetre.
        if k % 2 == 0 and world.arm_state()[1].min() >= jaw_m / 2:
            world.command_fingers(0.0)
            return True
        if k % every == 0 and watch(Phase.OPEN):
            break
    world.command_fingers(0.0)
    return False


def pressing_fingers(world: PhysicsWorld) -> int:
    """Number of fingers that press on the object: 0, 1 or 2."""
    return sum(world.force_n("robot", "object", link) > 0.0 for link in FINGER_LINKS)
