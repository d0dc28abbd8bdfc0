"""Antipodal contact pairs on a mesh by ray casting; see grasp_pool.py for the grasps made of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

# Edges that turn by more than this are edges to a pad; the eight facets of an oval handle, up to 70 degrees apart, are its round side.
SHARP_EDGE_RAD = np.radians(75.0)
_PAIRS_AT_ONCE = 400_000  # ray-triangle pairs: bounds the arrays to some 10 MB


@dataclass(frozen=True, slots=True)
class ContactPairs:
    """Opposite contacts: points in the object frame and outward normals; the jaw line runs from `a` to `b`."""

    a_m: Float[np.ndarray, "n 3"]
    b_m: Float[np.ndarray, "n 3"]
    normal_a: Float[np.ndarray, "n 3"]
    normal_b: Float[np.ndarray, "n 3"]

    @property
    def width_m(self) -> Float[np.ndarray, "n"]:
        return np.asarray(np.linalg.norm(self.b_m - self.a_m, axis=1))

    @property
    def axis(self) -> Float[np.ndarray, "n 3"]:
        """Unit vectors from `a` to `b`."""
        return np.asarray((self.b_m - self.a_m) / self.width_m[:, None])

    def contact_angle_rad(self) -> Float[np.ndarray, "n"]:
        """The larger angle between jaw line and surface normal of the two contacts."""
        cosines = np.minimum(-np.einsum("ij,ij->i", self.axis, self.normal_a), np.einsum("ij,ij->i", self.axis, self.normal_b))
        return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))

    def where(self, keep: Bool[np.ndarray, "n"] | Int[np.ndarray, "m"]) -> ContactPairs:
        return ContactPairs(self.a_m[keep], self.b_m[keep], self.normal_a[keep], self.normal_b[keep])


def antipodal_pairs(
    mesh: trimesh.Trimesh, n_samples: int, cone_rad: float, jitter_rad: float, max_width_m: float, rng: np.random.Generator
) -> tuple[ContactPairs, float]:
    """Contact pairs inside both friction cones and no wider than the jaw.

    From each surface point one ray is cast along the inward normal and one at random close to it; every place where a ray leaves the
    solid is a possible second contact, so that a mug gives pairs across its wall and across its body.

    Args:
        n_samples: surface points, drawn in proportion to area.
        cone_rad: half angle of the friction cone.
        jitter_rad: half angle of the cone that the second ray is drawn from.

    Returns:
        The pairs, and the smallest width of any pair inside the cones, whatever the jaw (infinite without any).
    """
    a, face = surface_points(mesh, n_samples, rng)
    normal_a = mesh.face_normals[face]
    straight = -normal_a
    tilted = _in_cone(straight, jitter_rad, rng)
    origins, directions = np.vstack([a, a]), np.vstack([straight, tilted])
    ray, b, exit_face = ray_exits(mesh, origins, directions)
    pairs = ContactPairs(origins[ray], b, np.vstack([normal_a, normal_a])[ray], mesh.face_normals[exit_face])
    pairs = pairs.where(pairs.width_m > 1e-3)
    pairs = pairs.where(pairs.contact_angle_rad() <= cone_rad)
    narrowest = float(pairs.width_m.min()) if len(pairs.a_m) else np.inf
    return pairs.where(pairs.width_m <= max_width_m), narrowest


def surface_points(mesh: trimesh.Trimesh, n: int, rng: np.random.Generator) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "n"]]:
    """Points uniform over the surface, and the faces they lie on."""
    face = rng.choice(len(mesh.faces), size=n, p=mesh.area_faces / mesh.area_faces.sum())
    u, v = rng.random((2, n))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    corner = mesh.triangles[face]
    return corner[:, 0] + u[:, None] * (corner[:, 1] - corner[:, 0]) + v[:, None] * (corner[:, 2] - corner[:, 0]), face


def ray_exits(
    mesh: trimesh.Trimesh, origins_m: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k 3"], Int[np.ndarray, "k"]]:
    """Where rays leave a watertight mesh (Moeller and Trumbore, "Fast, minimum storage ray-triangle intersection", 1997).

    Returns:
        Ray numbers (ascending), exit points and exit faces; exits closer than 1e-6 m to each other on one ray are one.
    """
    corner, edge_1, edge_2 = mesh.triangles[:, 0], *(mesh.triangles[:, k] - mesh.triangles[:, 0] for k in (1, 2))
    rays, points, faces = [], [], []
    step = max(1, _PAIRS_AT_ONCE // len(mesh.faces))
    for start in range(0, len(origins_m), step):
        o, d = origins_m[start : start + step, None], directions[start : start + step, None]
        p = np.cross(d, edge_2[None])
        det = np.einsum("fk,nfk->nf", edge_1, p)
        leaves = det < -1e-14  # the ray runs along the outward normal
        inverse = 1.0 / np.where(leaves, det, 1.0)
        t_vec = o - corner[None]
        u = np.einsum("nfk,nfk->nf", t_vec, p) * inverse
        q = np.cross(t_vec, edge_1[None])
        v = np.einsum("nfk,nfk->nf", np.broadcast_to(d, q.shape), q) * inverse
        t = np.einsum("fk,nfk->nf", edge_2, q) * inverse
        hit = leaves & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (t > 1e-6)
        ray, face = np.nonzero(hit)
        distance = t[ray, face]
        order = np.lexsort((face, distance, ray))
        ray, face, distance = ray[order], face[order], distance[order]
        first = np.ones(len(ray), dtype=bool)
        first[1:] = (ray[1:] != ray[:-1]) | (np.diff(distance) > 1e-6)
        ray, face, distance = ray[first], face[first], distance[first]
        rays.append(ray + start)
        points.append(o[ray, 0] + distance[:, None] * d[ray, 0])
        faces.append(face)
    return np.concatenate(rays), np.concatenate(points), np.concatenate(faces)


def sharp_edge_distance(mesh: trimesh.Trimesh, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Distance of points to the nearest sharp edge of a mesh, infinite where it has none."""
    ends = mesh.vertices[mesh.face_adjacency_edges[mesh.face_adjacency_angles > SHARP_EDGE_RAD]]
    nearest = np.full(len(points_m), np.inf)
    for start, end in ends:
        along = end - start
        t = np.clip((points_m - start) @ along / (along @ along), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points_m - start - t[:, None] * along, axis=1))
    return nearest


def _in_cone(axes: Float[np.ndarray, "n 3"], half_angle_rad: float, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Directions uniform over the cap of a cone about each axis."""
    cosine = rng.uniform(np.cos(half_angle_rad), 1.0, len(axes))
    sine, turn = np.sqrt(1.0 - cosine**2), rng.uniform(0.0, 2 * np.pi, len(axes))
    side_1, side_2 = perpendicular(axes)
    return np.asarray(cosine[:, None] * axes + sine[:, None] * (np.cos(turn)[:, None] * side_1 + np.sin(turn)[:, None] * side_2))


def perpendicular(axes: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Two unit vectors per axis that complete a right-handed frame (side_1, side_2, axis): the first is z, or x, made perpendicular."""
    reference = np.where(np.abs(axes[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    side_1 = reference - np.einsum("ij,ij->i", reference, axes)[:, None] * axes
    side_1 /= np.linalg.norm(side_1, axis=1, keepdims=True)
    return side_1, np.cross(axes, side_1)
