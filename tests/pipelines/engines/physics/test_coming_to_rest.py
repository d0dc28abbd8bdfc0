"""Rest must be recognised, and what keeps moving must not be taken for it, in either engine; waits and watches keep the recipe's pace."""

from __future__ import annotations

import numpy as np
import pybullet

from pipelines.engines.physics.coming_to_rest import n_steps_of, settle
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_rollout import hold
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.params import PhysicsParams
from pipelines.engines.physics.phases import Phase
from pipelines.engines.physics.world import PhysicsWorld
from pipelines.engines.robot.arm import HOME_Q_RAD
from tests.pipelines.engines.physics.object_models import can_model


def _standing() -> np.ndarray:
    T = can_model().stable_poses[0].T_plane_object.copy()
    T[:2, 3] = 0.5, 0.05
    return T


def test_what_keeps_moving_is_not_settled() -> None:
    with PhysicsWorld(can_model(), (), PhysicsParams()) as world:
        world.rebuild("thrown")
        world.set_object(_standing())
        assert settle(world, 100)
        assert world.n_steps == 24  # three checks, eight steps apart
        pybullet.resetBaseVelocity(world._ids["object"], [0.0, 0.0, 3.0], [0.0] * 3, physicsClientId=world._client)
        assert not settle(world, 100)


def test_what_keeps_falling_is_not_settled() -> None:
    T = _standing()
    for height_m, is_settled in ((0.0, True), (3.0, False)):
        T[2, 3] += height_m
        with HandWorld(can_model(), (), HandWorldParams()) as world:
            world.start_open("fall", HOME_Q_RAD, 0.04, T)
            world.remove_hand()
            assert settle(world, 100) is is_settled
            assert world.n_steps == (24 if is_settled else 100)


def test_a_watch_ends_a_hold_and_sees_it_at_the_pace_of_the_recipe() -> None:
    seen: list[int] = []
    with HandWorld(can_model(), (), HandWorldParams()) as world:
        world.start_open("watched", HOME_Q_RAD, 0.04, _standing())

        def watch(phase: Phase) -> bool:
            seen.append(world.n_steps)
            return len(seen) == 3

        assert not hold(world, Phase.HOLD, 1.0, watch)
        assert seen == [8, 16, 24]
        assert world.n_steps == 24
        assert n_steps_of(world, 0.5) == 120
