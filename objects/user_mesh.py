"""The mesh file that a user brings as one closed body in metres, or one line that says why not; mesh_repair.py has each repair.

Nothing is changed silently: every change is a note. Where a change is a guess (a hole closed, a fold cut away, faces saved) the volume may
move by MAX_VOLUME_CHANGE at most. Two are no guess and have no bound: what overlapping bodies have in common counts once, and a sealed void
is filled: nothing touches its walls, the mass is the catalogue's, and the inertia is that of a solid.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from objects.catalogue import MeshShape
from objects.errors import MeshError
from objects.mesh_holes import Closing, closed
from objects.mesh_repair import crossed_edges, joined, n_open_edges, simplified, uncrossed, volume_m3, welded
from objects.mesh_shells import shells_of

# What trimesh reads by itself. COLLADA (.dae) and 3MF would need pycollada and lxml; glTF with files beside it would change unseen.
EXTENSIONS = (".glb", ".obj", ".off", ".ply", ".stl")
# A household object that a 0.08 m jaw can take: a mesh beyond these bounds was almost surely exported in millimetres or inches.
MIN_EXTENT_M, MAX_EXTENT_M = 0.010, 0.400
# Decomposition and ray casting take seconds at this size, minutes beyond.
MAX_FACES = 20_000
# What may be read where `max_faces` asks for fewer.
MAX_FILE_FACES = 1_000_000
MAX_VOLUME_CHANGE = 0.02
MAX_SHELLS = 1000
# Of edges: two limbs that run through each other cross at one in a hundred, a fold at a seam or a crease at a few.
MAX_FOLD_SHARE = 0.002
# A body with less of the volume is a crumb of the scanner or of the modelling program.
MAX_CRUMB_SHARE = 0.001


@dataclass(frozen=True, slots=True)
class UserMesh:
    """One closed body about the centre of its bounding box, metres, and what was changed to get there."""

    mesh: trimesh.Trimesh
    notes: tuple[str, ...]


def user_mesh(object_id: str, shape: MeshShape) -> UserMesh:
    """The mesh of a file, repaired where that is safe.

    Raises:
        MeshError: the file cannot be read, its mesh has an implausible size, is open beyond repair, or is not one body.
    """
    what = f"{object_id}: mesh file {shape.path}"
    vertices, faces = _read(what, shape.path)
    _check_faces(what, len(faces), shape.max_faces)
    mesh = trimesh.Trimesh(vertices * shape.scale, faces, process=False)
    check_extents(object_id, mesh.extents)
    mesh, notes = welded(mesh)
    shells, parting = shells_of(mesh)
    if len(shells) > MAX_SHELLS:
        raise MeshError(f"{what} falls into {len(shells)} pieces, must be at most {MAX_SHELLS}: is it a scan that was never joined?")
    closing = closed(shells)
    if closing.why_not:
        raise MeshError(f"{what} is not watertight: {closing.why_not}; no cap closes it safely")
    if n_open := sum(map(n_open_edges, closing.shells)):
        raise MeshError(f"{what} is not watertight: {n_open} edges without exactly two faces, must be 0; no repair closes it safely")
    in_file = "unknown" if closing.notes else f"{abs(volume_m3(shells)) * 1e6:.4g} cm3"
    mesh, joining = _one_body(what, closing.shells)
    _check_doubt(what, closing, float(mesh.volume))
    if shape.max_faces is not None and len(mesh.faces) > shape.max_faces:
        mesh, joining = _simplified(what, mesh, shape.max_faces, joining)
    if len(mesh.faces) > MAX_FACES:
        raise MeshError(f"{what} has {len(mesh.faces)} faces after repair, must be at most {MAX_FACES}: set max_faces = 5000, say")
    mesh, cutting = _uncrossed(what, mesh)
    notes = [*notes, *parting, *closing.notes, *joining, *cutting]
    if notes:
        notes.append(f"volume {in_file} in the file, {float(mesh.volume) * 1e6:.4g} cm3 now")
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    return UserMesh(mesh, tuple(notes))


def check_extents(object_id: str, extents_m: Float[np.ndarray, "3"]) -> None:
    """Refuse what is no household object in metres."""
    for axis, extent in zip("xyz", extents_m, strict=True):
        if not MIN_EXTENT_M <= extent <= MAX_EXTENT_M:
            raise MeshError(
                f"{object_id}: extent along {axis} {extent:.4g} m, must be in [{MIN_EXTENT_M}, {MAX_EXTENT_M}] m"
                " (is the file in another unit? set scale)"
            )


def _read(what: str, path: Path) -> tuple[Float[np.ndarray, "v 3"], Any]:
    """Vertices and faces of a file as they stand there."""
    if path.suffix.lower() not in EXTENSIONS:
        raise MeshError(f"{what} has the extension {path.suffix!r}, must be one of {', '.join(EXTENSIONS)}: convert it")
    try:
        n_bytes = path.stat().st_size
        loaded: Any = trimesh.load_mesh(path, process=False) if n_bytes else None
    except FileNotFoundError as error:
        raise MeshError(f"{what} does not exist") from error
    except Exception as error:  # the readers raise whatever their parsing trips over: struct.error, TypeError, AttributeError ...
        raise MeshError(f"{what} cannot be read: {_one_line(error)}") from error
    if loaded is None:
        raise MeshError(f"{what} is empty (0 bytes)")
    faces = np.asarray(getattr(loaded, "faces", np.empty((0, 3))), dtype=np.int64).reshape(-1, 3)
    vertices = np.asarray(getattr(loaded, "vertices", np.empty((0, 3))), dtype=np.float64).reshape(-1, 3)
    if n_bad := int(np.sum(~np.isfinite(vertices).all(axis=1))):
        raise MeshError(f"{what} has {n_bad} of {len(vertices)} vertices that are not finite numbers, must be 0")
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise MeshError(f"{what} has faces of vertex {faces.max()}, must be below {len(vertices)}")
    return vertices, faces


def _one_line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def _check_faces(what: str, n_faces: int, max_faces: int | None) -> None:
    most = MAX_FACES if max_faces is None else MAX_FILE_FACES
    if not 4 <= n_faces <= most:
        hint = "; set max_faces = 5000, say, to have it simplified" if MAX_FACES < n_faces <= MAX_FILE_FACES else ""
        raise MeshError(f"{what} has {n_faces} faces, must be in [4, {most}]{hint}")


def _one_body(what: str, shells: list[trimesh.Trimesh]) -> tuple[trimesh.Trimesh, list[str]]:
    """The union of closed shells where it is one body, crumbs aside."""
    bodies, notes = joined(shells)
    volumes = np.array([body.volume for body in bodies])
    if not len(bodies) or volumes.sum() <= 1e-12:
        raise MeshError(f"{what} encloses {volumes.sum():.3g} m3, must be > 0")
    share = volumes / volumes.sum()
    large = [body for body, part in zip(bodies, share, strict=True) if part >= MAX_CRUMB_SHARE]
    if len(large) > 1:
        shares = ", ".join(f"{part:.1%}" for part in sorted(share, reverse=True)[:5])
        raise MeshError(f"{what} holds {len(large)} separate bodies ({shares} of the volume), must be 1")
    if n_crumbs := len(bodies) - 1:
        notes.append(f"left out {n_crumbs} crumbs with {1.0 - share.max():.3%} of the volume")
    return large[0], notes


def _check_doubt(what: str, closing: Closing, volume_m3: float) -> None:
    if closing.doubt_m3 > MAX_VOLUME_CHANGE * volume_m3:
        raise MeshError(
            f"{what} is not watertight: {closing.notes[0].removeprefix('closed ')}, may have held {closing.doubt_m3 * 1e6:.4g} cm3, must be"
            f" at most {MAX_VOLUME_CHANGE:.0%} of the {volume_m3 * 1e6:.4g} cm3 within flat caps"
        )


def _simplified(what: str, mesh: trimesh.Trimesh, max_faces: int, notes: list[str]) -> tuple[trimesh.Trimesh, list[str]]:
    """A mesh of few enough faces, its volume within bounds."""
    fewer, moved_m = simplified(mesh, max_faces)
    if len(fewer.faces) > max_faces:
        raise MeshError(
            f"{what} has {len(fewer.faces)} faces after simplifying {len(mesh.faces)} by {moved_m * 1e3:g} mm, must be at most {max_faces}"
        )
    _check_volume(what, f"simplifying it to {len(fewer.faces)} faces", float(mesh.volume), float(fewer.volume))
    note = f"simplified from {len(mesh.faces)} to {len(fewer.faces)} faces, none moved by more than {moved_m * 1e3:g} mm"
    return fewer, [*notes, note]


def _uncrossed(what: str, mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, list[str]]:
    """A body that does not run through itself, small folds aside."""
    n_crossed, n_edges = crossed_edges(mesh), len(mesh.edges_unique)
    if not n_crossed:
        return mesh, []
    whole = uncrossed(mesh)
    if not crossed_edges(whole):
        _check_volume(what, "a union of the pieces that run through each other", float(mesh.volume), float(whole.volume))
        return whole, [f"made one of pieces that ran through each other at {n_crossed} edges"]
    if n_crossed <= MAX_FOLD_SHARE * n_edges:
        return mesh, [f"left as it is where it folds into itself, at {n_crossed} of {n_edges} edges"]
    raise MeshError(
        f"{what} runs through itself at {n_crossed} of {n_edges} edges, must at {MAX_FOLD_SHARE:.1%} at most; no union mends it"
    )


def _check_volume(what: str, change: str, before_m3: float, after_m3: float) -> None:
    before_m3, after_m3 = abs(before_m3), abs(after_m3)
    if abs(after_m3 - before_m3) > MAX_VOLUME_CHANGE * before_m3:
        raise MeshError(
            f"{what}: {change} takes its volume from {before_m3 * 1e6:.4g} to {after_m3 * 1e6:.4g} cm3,"
            f" must change by at most {MAX_VOLUME_CHANGE:.0%}"
        )
