"""What touched what in Bullet's last step, and how hard; who asks is bullet_world.py."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipelines.engines.bullet import pybullet
from pipelines.proofs.validity.second_engine.bullet_bodies import HandIds

# Fields of a contact point: bodies, links, normal on b, normal force on a along it, two friction forces and their directions.
_A, _B, _LINK_A, _LINK_B, _NORMAL, _FORCE = 1, 2, 3, 4, 7, 9
_FRICTION = ((10, 11), (12, 13))


@dataclass(frozen=True, slots=True)
class StepContacts:
    """Contacts of one step.

    Attributes:
        pressing: parts of the hand that pressed on the object.
        on_hand_n: size of the net force on the hand.
        fixed_n: of the net force between "object" or "robot" and table or an obstacle, where there is any.
    """

    pressing: frozenset[str]
    on_hand_n: float
    fixed_n: dict[tuple[str, str], float]


def read_contacts(client: int, object_body: int, hand: HandIds | None, fixed: Mapping[int, str]) -> StepContacts:
    """Read them.

    Args:
        fixed: names of table and obstacles by body.
    """
    hand_body = -1 if hand is None else hand.body
    names = {object_body: "object", hand_body: "robot"}
    pressing: set[str] = set()
    on_hand, nets = np.zeros(3), dict[tuple[str, str], np.ndarray]()
    for point in pybullet.getContactPoints(physicsClientId=client) or ():
        if point[_FORCE] <= 0.0:
            continue  # near, but not touching
        a, b = point[_A], point[_B]
        on_a = point[_FORCE] * np.array(point[_NORMAL])
        for size, direction in _FRICTION:
            on_a += point[size] * np.array(point[direction])
        if hand_body in (a, b):
            on_hand += on_a if a == hand_body else -on_a
        if hand is not None and {a, b} == {hand_body, object_body}:
            pressing.add(hand.part_of[point[_LINK_A] if a == hand_body else point[_LINK_B]])
        for moving, other, sign in ((a, b, 1.0), (b, a, -1.0)):
            if other in fixed and moving in names:
                key = names[moving], fixed[other]
                nets[key] = nets.get(key, np.zeros(3)) + sign * on_a
    return StepContacts(frozenset(pressing), float(np.linalg.norm(on_hand)), {key: float(np.linalg.norm(net)) for key, net in nets.items()})
