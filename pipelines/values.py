"""The values that stages hand on: a scene, an admitted grasp, a lifted grasp, a plan; as table rows they are codecs.py's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


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
    """Joint waypoints of a solved candidate: post-lift to pre-place, to place, and back to the retreat pose."""

    transport_q_rad: Float[np.ndarray, "a 7"]
    descend_q_rad: Float[np.ndarray, "b 7"]
    retreat_q_rad: Float[np.ndarray, "c 7"]
