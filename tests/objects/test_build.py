"""Tables of built objects: mass properties in closed form, schemas, and the same bits in another process."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from objects.build import ObjectParams, build_object, build_object_models, inertia_kg_m2, object_models_of
from objects.catalogue import CanShape, CuboidShape, load_catalogue
from objects.errors import ObjectError
from objects.grasp_pool import GraspPoolParams
from objects.mug import mug_mesh
from tables.schemas import GRASP_POOL, OBJECT_MESHES, OBJECT_PARTS, OBJECTS, STABLE_POSES
from tables.store import content_hash, read_table, table_from_rows, write_table
from tests.objects.shapes import MUG_SHAPE, mesh_spec, spec_of

# Fewer candidates: the mechanics are the same and a build takes a fifth of the time.
QUICK = ObjectParams(grasp_pool=GraspPoolParams(n_candidates=4000, n_grasps=24, min_grasps=24))


def test_inertia_of_box_and_can_is_the_textbooks() -> None:
    box = inertia_kg_m2(trimesh.creation.box(extents=(0.04, 0.06, 0.1)), 0.3)
    assert box == pytest.approx(0.3 / 12 * np.diag([0.06**2 + 0.1**2, 0.04**2 + 0.1**2, 0.04**2 + 0.06**2]), abs=1e-12)
    can = inertia_kg_m2(trimesh.creation.cylinder(radius=0.033, height=0.1, sections=480), 0.3)
    across = 0.3 / 12 * (3 * 0.033**2 + 0.1**2)
    assert can == pytest.approx(np.diag([across, across, 0.3 * 0.033**2 / 2]), rel=1e-3, abs=1e-9)


def test_inertia_does_not_depend_on_where_the_mesh_lies_and_scales_with_mass() -> None:
    mesh = mug_mesh(MUG_SHAPE)
    moved = mesh.copy()
    moved.apply_translation([0.3, -0.2, 0.1])
    assert inertia_kg_m2(moved, 0.2) == pytest.approx(inertia_kg_m2(mesh, 0.1) * 2, rel=1e-6, abs=1e-9)


def test_tables_of_a_mug_obey_their_schemas_and_come_back_as_a_model(tmp_path: Path) -> None:
    spec = spec_of(MUG_SHAPE, "cup", mass_kg=0.34)
    built = build_object(spec, QUICK, 3)
    for schema, rows in (
        (OBJECTS, built.objects),
        (OBJECT_MESHES, built.object_meshes),
        (OBJECT_PARTS, built.object_parts),
        (STABLE_POSES, built.stable_poses),
        (GRASP_POOL, built.grasp_pool),
    ):
        table = table_from_rows(schema, rows)
        write_table(schema, table, tmp_path / f"{schema.name}.parquet")
        assert content_hash(read_table(schema, tmp_path / f"{schema.name}.parquet", verify=True)) == content_hash(table)
    object_model = object_models_of([built])["cup"]
    mesh = mug_mesh(MUG_SHAPE)
    assert object_model.mesh.vertices_m == pytest.approx(np.asarray(mesh.vertices), abs=0.0)
    assert object_model.com_m == pytest.approx(mesh.center_mass)
    assert object_model.mass_kg == 0.34
    assert np.linalg.eigvalsh(object_model.inertia_kg_m2).min() > 0.0
    moments = np.linalg.eigvalsh(object_model.inertia_kg_m2)
    assert moments[0] + moments[1] >= moments[2], "no body has such moments"
    assert len(object_model.grasps) == 24
    row = built.objects[0]
    assert row["size_x_m"] == pytest.approx(0.118, rel=0.01)
    assert row["mesh_volume_m3"] == pytest.approx(mesh.volume)
    assert row["min_graspable_width_m"] == min(grasp.jaw_width_m for grasp in object_model.grasps)


def test_a_partly_filled_container_has_its_weight_where_the_catalogue_says() -> None:
    object_model = build_object_models([spec_of(CuboidShape((0.06, 0.05, 0.15)), "carton", com_z_m=-0.03)], QUICK, 3)["carton"]
    assert object_model.com_m == pytest.approx([0.0, 0.0, -0.03])


def test_objects_without_cavity_have_no_fill() -> None:
    row = build_object(spec_of(CanShape(0.06, 0.1), "tin"), QUICK, 3).objects[0]
    assert row["cavity_fill"] is None
    assert row["handle_hole_fill"] is None
    assert row["hull_volume_ratio"] == pytest.approx(1.0)


def test_a_users_mesh_becomes_an_object_like_any_other(tmp_path: Path) -> None:
    bars = [trimesh.creation.box(bounds=bounds) for bounds in ([[0, 0, 0], [0.08, 0.02, 0.03]], [[0, 0, 0], [0.02, 0.07, 0.03]])]
    trimesh.boolean.union(bars, engine="manifold").export(tmp_path / "own.stl")
    built = build_object(mesh_spec(tmp_path / "own.stl"), QUICK, 3)
    assert built.objects[0]["category"] == "mesh"
    assert len(built.object_parts) == 2
    assert {grasp["grasp_kind"] for grasp in built.grasp_pool} == {"grip"}
    assert sum(pose["probability"] for pose in built.stable_poses) == pytest.approx(1.0)


def test_an_object_that_cannot_be_built_raises_one_family_of_errors(tmp_path: Path) -> None:
    with pytest.raises(ObjectError, match="thing"):
        build_object(spec_of(CuboidShape((0.1, 0.1, 0.1))), QUICK, 3)
    with pytest.raises(ObjectError, match="own"):
        build_object(mesh_spec(tmp_path / "none.stl"), QUICK, 3)


@pytest.mark.parametrize("object_id", ["mug_05", "can_07", "cuboid_06"])
def test_another_process_builds_the_same_bits(object_id: str) -> None:
    """Another hash seed and thread count, the catalogue read anew, nothing shared but the code."""
    spec = next(s for s in load_catalogue() if s.object_id == object_id)
    here = digest(dataclasses.asdict(build_object(spec, QUICK, 5)))
    code = (
        "from tests.objects.test_build import *\n"
        f"spec = next(s for s in load_catalogue() if s.object_id == {object_id!r})\n"
        "print(digest(dataclasses.asdict(build_object(spec, QUICK, 5))))\n"
    )
    root = str(Path(__file__).parents[2])
    env = {**os.environ, "PYTHONHASHSEED": "4711", "OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2", "PYTHONPATH": root}
    there = subprocess.run([sys.executable, "-c", code], env=env, cwd=root, capture_output=True, text=True, check=True).stdout.strip()
    assert there == here


def digest(tables: dict[str, object]) -> str:
    return hashlib.sha256(json.dumps(tables, sort_keys=True).encode()).hexdigest()
