"""The values that stages hand on: a scene, an admitted grasp, a lifted grasp, a plan; see codecs.py for table rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from tables.identity import IdentityError, candidate_id_of
from tables.poses import inverse

# The workbench that the arm stands on, top at z = 0, in the base frame.
TABLE_X_M = (-0.4, 1.1)
TABLE_Y_M = (-0.9, 0.9)
GRAVITY_M_S2 = 9.81


@dataclass(frozen=True, slots=True)
class SceneAllocation:
    """What identity alone decides about a scene: its object and its number of obstacles."""

    scene_id: str
    object_id: str
    category: str
    n_obstacles: int


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A box on the table; `T_base_obstacle` is its centre."""

    obstacle_id: int
    T_base_obstacle: Float[np.ndarray, "4 4"]
    size_m: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class Target:
    """A requested object pose."""

    target_id: int
    stable_pose_id: int
    T_base_target: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True)
class Scene:
    """One object at its initial pose, its obstacles and its targets."""

    scene_id: str
    object_id: str
    stable_pose_id: int
    T_base_object: Float[np.ndarray, "4 4"]
    obstacles: tuple[Obstacle, ...]
    targets: tuple[Target, ...]

    def target(self, target_id: int) -> Target:
        """A target of the scene; raises IdentityError where it has none of that id."""
        for target in self.targets:
            if target.target_id == target_id:
                return target
        raise IdentityError(f"{self.scene_id}: target {target_id}, must be one of {[target.target_id for target in self.targets]}")


@dataclass(frozen=True, slots=True)
class AdmittedGrasp:
    """A grasp that passed geometric admission: TCP pose and the arm at pregrasp and grasp (same redundancy q7)."""

    grasp_id: int
    T_base_grasp: Float[np.ndarray, "4 4"]
    pregrasp_q_rad: Float[np.ndarray, "7"]
    grasp_q_rad: Float[np.ndarray, "7"]


@dataclass(frozen=True, slots=True)
class LiftedGrasp:
    """The measured state after the pick-lift check: where planning and execution start."""

    grasp_id: int
    lifted_q_rad: Float[np.ndarray, "7"]
    fingers_m: Float[np.ndarray, "2"]
    T_base_lifted: Float[np.ndarray, "4 4"]
    T_tcp_object: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True)
class Plan:
    """What is stored of a solved candidate: where the hand lets go, and the waypoints of the transport between lift and pre-place."""

    place_q_rad: Float[np.ndarray, "7"]
    via_q_rad: Float[np.ndarray, "k 7"]


@dataclass(frozen=True, slots=True)
class Motion:
    """Joint waypoints of a placement: post-lift to pre-place, to place, and back to the retreat pose."""

    transport_q_rad: Float[np.ndarray, "a 7"]
    descend_q_rad: Float[np.ndarray, "b 7"]
    retreat_q_rad: Float[np.ndarray, "c 7"]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A lifted grasp and a target of one scene: what is planned, executed and ranked."""

    scene: Scene
    grasp: LiftedGrasp
    target: Target

    @property
    def candidate_id(self) -> str:
        return candidate_id_of(self.scene.scene_id, self.target.target_id, self.grasp.grasp_id)

    def release_pose(self, release_height_m: float) -> Float[np.ndarray, "4 4"]:
        """T_base_object where the hand lets go: the target, so much higher."""
        T_base_object = self.target.T_base_target.copy()
        T_base_object[2, 3] += release_height_m
        return T_base_object

    def place_pose(self, release_height_m: float) -> Float[np.ndarray, "4 4"]:
        """T_base_tcp where the hand lets go, with the object as it was measured in the hand after the lift."""
        T_base_tcp: Float[np.ndarray, "4 4"] = self.release_pose(release_height_m) @ inverse(self.grasp.T_tcp_object)
        return T_base_tcp


@dataclass(frozen=True, slots=True)
class Known:
    """What earlier stages found out about a scene; empty where a stage does not read it. Plans are by candidate id."""

    scene: Scene | None = None
    admitted: tuple[AdmittedGrasp, ...] = ()
    lifted: tuple[LiftedGrasp, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    plans: Mapping[str, Plan] = field(default_factory=dict)

    def of_grasp(self, grasp_id: int) -> Known:
        """What of it concerns one grasp."""
        candidates = tuple(candidate for candidate in self.candidates if candidate.grasp.grasp_id == grasp_id)
        return Known(
            self.scene,
            tuple(grasp for grasp in self.admitted if grasp.grasp_id == grasp_id),
            tuple(grasp for grasp in self.lifted if grasp.grasp_id == grasp_id),
            candidates,
            {c.candidate_id: self.plans[c.candidate_id] for c in candidates if c.candidate_id in self.plans},
        )
