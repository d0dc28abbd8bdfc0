"""What an object is made from changes with everything that may change its rows, and with nothing else."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import trimesh

from objects import provenance
from objects.build import ObjectParams
from objects.catalogue import CanShape, ObjectSpec, load_catalogue
from objects.decomposition import DecompositionParams
from objects.grasp_pool import GraspPoolParams
from objects.provenance import catalogue_sources, entry_sha256, object_sources
from objects.stable_poses import StablePoseParams
from tests.objects.shapes import mesh_spec, spec_of

PARAMS = ObjectParams()
SPEC = spec_of(CanShape(0.06, 0.1), "tin")


def test_every_object_of_the_catalogue_has_an_entry_of_its_own() -> None:
    specs = load_catalogue()
    assert len({entry_sha256(spec) for spec in specs}) == len(specs) == 30


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(ObjectSpec) if f.name not in ("category", "symmetry", "shape")])
def test_every_field_of_an_entry_counts(field: str) -> None:
    value = getattr(SPEC, field)
    other = value + "x" if isinstance(value, str) else (0.0, 0.0, 0.01) if isinstance(value, tuple) else value * 1.0000001
    assert entry_sha256(dataclasses.replace(SPEC, **{field: other})) != entry_sha256(SPEC)
    assert entry_sha256(dataclasses.replace(SPEC, shape=CanShape(0.06, 0.10000001))) != entry_sha256(SPEC)


@pytest.mark.parametrize(
    ("params", "seed"),
    [
        (dataclasses.replace(PARAMS, decomposition=DecompositionParams(max_parts=31)), 1),
        (dataclasses.replace(PARAMS, stable_poses=StablePoseParams(merge_rad=0.15)), 1),
        (dataclasses.replace(PARAMS, grasp_pool=GraspPoolParams(friction=0.4)), 1),
        # The same shares in another order: ties between kinds are broken by it.
        (dataclasses.replace(PARAMS, grasp_pool=GraspPoolParams(shares=dict(reversed(PARAMS.grasp_pool.shares.items())))), 1),
        (PARAMS, 2),
    ],
)
def test_parameters_and_seed_count(params: ObjectParams, seed: int) -> None:
    assert object_sources(SPEC, params, seed) != object_sources(SPEC, PARAMS, 1)
    assert catalogue_sources([SPEC], params, seed) != catalogue_sources([SPEC], PARAMS, 1)


def test_code_and_library_versions_count(monkeypatch: pytest.MonkeyPatch) -> None:
    before = object_sources(SPEC, PARAMS, 1)
    for name in ("coacd", "trimesh", "manifold3d", "numpy", "scipy", "coal"):
        real = provenance.version(name)
        assert f"{name} {real}" in before["libraries"].split(", ")
        with monkeypatch.context() as patch:
            patch.setattr(provenance, "version", lambda asked, name=name, real=real: f"{real}.1" if asked == name else "0")
            assert f"{name} {real}.1" in object_sources(SPEC, PARAMS, 1)["libraries"]
    monkeypatch.setattr(provenance, "OBJECT_CODE_VERSION", "next")
    assert object_sources(SPEC, PARAMS, 1) != before


def test_a_mesh_file_counts_by_its_content_and_not_by_where_it_lies(tmp_path: Path) -> None:
    here, there = tmp_path / "here" / "own.stl", tmp_path / "there" / "renamed.stl"
    for path in (here, there):
        path.parent.mkdir()
        trimesh.creation.box(extents=(0.03, 0.04, 0.05)).export(path)
    before = entry_sha256(mesh_spec(here))
    assert entry_sha256(mesh_spec(there)) == before
    assert entry_sha256(mesh_spec(here, scale=2.0)) != before
    trimesh.creation.box(extents=(0.03, 0.04, 0.051)).export(here)
    assert entry_sha256(mesh_spec(here)) != before
    here.unlink()
    assert entry_sha256(mesh_spec(here)) not in (before, entry_sha256(mesh_spec(there)))


def test_the_sources_of_the_catalogue_do_not_depend_on_its_order_and_those_of_an_object_not_on_the_others() -> None:
    specs = load_catalogue()
    assert catalogue_sources(specs[::-1], PARAMS, 1) == catalogue_sources(specs, PARAMS, 1)
    assert catalogue_sources(specs[:-1], PARAMS, 1) != catalogue_sources(specs, PARAMS, 1)
    changed = dataclasses.replace(specs[0], mass_kg=0.1)
    assert catalogue_sources([changed, *specs[1:]], PARAMS, 1) != catalogue_sources(specs, PARAMS, 1)
