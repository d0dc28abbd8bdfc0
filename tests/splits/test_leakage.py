from __future__ import annotations

from itertools import permutations

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from objects.object_model import ObjectModel
from splits.leakage import LeakKind, _is_matching, _turn_rad, find_leaks
from tables import schemas
from tables.poses import matrix_of, pose_columns, pose_of
from tables.store import table_from_rows
from tables.vocabulary import Symmetry
from tests.splits.changed import Row, changed


def shift_and_turn(row: Row, prefix: str, shift_m: float, turn_rad: float, half_turn: str = "") -> Row:
    """The row with its pose moved along base x, turned about base z, and optionally turned by pi about an object axis."""
    names = pose_columns(prefix)
    T = matrix_of(np.array([row[name] for name in names]))
    T[:3, :3] = Rotation.from_rotvec([0, 0, turn_rad]).as_matrix() @ T[:3, :3]
    if half_turn:
        T[:3, :3] = T[:3, :3] @ Rotation.from_euler(half_turn, np.pi).as_matrix()
    T[0, 3] += shift_m
    return row | dict(zip(names, pose_of(T).tolist(), strict=True))


def with_twin(tables: dict[str, pa.Table], shift_m: float, turn_rad: float, split: str, half_turn: str = "") -> dict[str, pa.Table]:
    """The release plus scene full-0099, which is full-0002 (a cuboid between two boxes) moved a little, targets in another order."""
    source, twin = "full-0002", "full-0099"
    out = dict(tables)
    for name, schema, prefix in (
        ("scenes", schemas.SCENES, "object"),
        ("obstacles", schemas.OBSTACLES, "obstacle"),
        ("targets", schemas.TARGETS, "target"),
    ):
        rows = tables[name].to_pylist()
        own = [shift_and_turn(row, prefix, shift_m, turn_rad, half_turn) for row in rows if row["scene_id"] == source]
        for number, row in enumerate(own):
            row["scene_id"] = twin
            key = {"obstacles": "obstacle_id", "targets": "target_id"}.get(name)
            if key:
                row[key] = len(own) - 1 - number
        out[name] = table_from_rows(schema, rows + own)
    splits = tables["splits"].to_pylist()
    own_splits = next(row for row in splits if row["scene_id"] == source)
    out["splits"] = table_from_rows(schemas.SPLITS, [*splits, {**own_splits, "scene_id": twin, "split": split}])
    return out


def split_in(tables: dict[str, pa.Table], scene_id: str) -> str:
    return str(next(row["split"] for row in tables["splits"].to_pylist() if row["scene_id"] == scene_id))


def test_a_sound_release_has_no_leak(release_tables: dict[str, pa.Table]) -> None:
    assert find_leaks(release_tables) == []


def test_a_scene_in_two_splits_leaks(release_tables: dict[str, pa.Table]) -> None:
    rows = release_tables["splits"].to_pylist()
    both = pa.Table.from_pylist([*rows, {"scene_id": "full-0003", "split": "train"}])
    (leak,) = find_leaks(release_tables | {"splits": both})
    assert leak.kind is LeakKind.SCENE_IN_TWO_SPLITS
    assert str(leak) == "scene_in_two_splits: full-0003: in 2 splits (train, validation), must be in 1"


def test_a_scene_in_two_splits_of_any_scheme_leaks(release_tables: dict[str, pa.Table]) -> None:
    rows = release_tables["splits"].to_pylist()
    own = next(row for row in rows if row["scene_id"] == "full-0000")
    both = pa.Table.from_pylist([*rows, own | {"split_layout": "validation"}])
    assert [str(leak) for leak in find_leaks(release_tables | {"splits": both})] == [
        "scene_in_two_splits: full-0000: in 2 splits of scheme layout (train, validation), must be in 1"
    ]


@pytest.mark.parametrize(
    ("scene_id", "column", "split", "said"),
    [
        ("full-0005", "split_object", "train", "object_in_two_splits: cuboid_02: in 2 splits of scheme object (test, train), must be in 1"),
        (
            "full-0004",
            "split_object",
            "test",
            "object_in_two_splits: mug_02: in 2 splits of scheme object (test, validation), must be in 1",
        ),
        ("full-0000", "split_category_can", "train", "not_held_out: full-0000: category can in train of scheme category_can"),
        ("full-0003", "split_category_can", "validation", "not_held_out: full-0003: category can in validation of scheme category_can"),
        ("full-0001", "split_category_cuboid", "test", "not_held_out: full-0001: category mug in test of scheme category_cuboid"),
        ("full-0001", "split_category_mug", "train", "not_held_out: full-0001: category mug in train of scheme category_mug"),
        ("full-0002", "split_layout", "train", "not_held_out: full-0002: obstacles 2 in train of scheme layout, whose test must have all"),
        ("full-0001", "split_layout", "test", "not_held_out: full-0001: obstacles 1 in test of scheme layout, whose test must have all"),
    ],
)
def test_what_a_scheme_promises_is_checked(release_tables: dict[str, pa.Table], scene_id: str, column: str, split: str, said: str) -> None:
    """One scene on the wrong side of one scheme, rows that no schema forbids."""
    planted = changed(schemas.SPLITS, release_tables["splits"], lambda row: row["scene_id"] == scene_id, **{column: split})
    (leak,) = find_leaks(release_tables | {"splits": planted})
    assert str(leak).startswith(said)


def test_obstacles_and_objects_are_counted_and_not_believed(release_tables: dict[str, pa.Table]) -> None:
    """A scene whose row says 2 obstacles where there is 1, or another category than its object's, is where the facts put it."""
    fewer = pa.Table.from_pylist(
        [row for row in release_tables["obstacles"].to_pylist() if (row["scene_id"], row["obstacle_id"]) != ("full-0002", 1)]
    )
    assert [leak.ids for leak in find_leaks(release_tables | {"obstacles": fewer})] == [("full-0002",)]
    renamed = changed(schemas.OBJECTS, release_tables["objects"], lambda row: row["object_id"] == "can_02", category="mug")
    leaks = find_leaks(release_tables | {"objects": renamed})
    assert {(leak.kind, *leak.ids) for leak in leaks} == {(LeakKind.NOT_HELD_OUT, name) for name in ("full-0003", "full-0009")}


def test_a_scene_without_a_split_leaks(release_tables: dict[str, pa.Table]) -> None:
    rows = [row for row in release_tables["splits"].to_pylist() if row["scene_id"] != "full-0005"]
    leaks = find_leaks(release_tables | {"splits": table_from_rows(schemas.SPLITS, rows)})
    assert [(leak.kind, leak.ids) for leak in leaks] == [(LeakKind.SCENE_WITHOUT_SPLIT, ("full-0005",))]


def test_a_candidate_in_two_groups_leaks(release_tables: dict[str, pa.Table]) -> None:
    candidates = release_tables["candidates"]
    copied = candidates["candidate_id"].to_pylist()[0]
    doubled = changed(schemas.CANDIDATES, candidates, lambda row: row["scene_id"] == "full-0005", candidate_id=copied)
    leaks = find_leaks(release_tables | {"candidates": doubled})
    assert {leak.kind for leak in leaks} == {LeakKind.CANDIDATE_IN_TWO_GROUPS, LeakKind.CANDIDATE_OF_ANOTHER_SCENE}
    assert all(leak.ids == (copied,) for leak in leaks)


def test_an_id_that_is_none_leaks(release_tables: dict[str, pa.Table]) -> None:
    strange = changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: True, candidate_id="full-1-t0")
    (leak,) = find_leaks(release_tables | {"candidates": strange})
    assert leak.kind is LeakKind.CANDIDATE_OF_ANOTHER_SCENE
    assert "is not a candidate id" in leak.found


@pytest.mark.parametrize(
    ("shift_m", "turn_deg", "half_turn", "is_leak"),
    [
        (0.0, 0.0, "", True),
        (0.0049, 0.0, "", True),
        (0.0051, 0.0, "", False),
        (0.0, 2.9, "", True),
        (0.0, 3.1, "", False),
        (0.0, 0.0, "x", True),  # the cuboid and the boxes look the same after half a turn
        (0.003, 2.0, "z", True),
    ],
)
def test_near_identical_scenes_leak_across_splits_only(
    release_tables: dict[str, pa.Table], shift_m: float, turn_deg: float, half_turn: str, is_leak: bool
) -> None:
    own = split_in(release_tables, "full-0002")
    other = "train" if own != "train" else "test"
    leaks = find_leaks(with_twin(release_tables, shift_m, np.deg2rad(turn_deg), other, half_turn))
    assert [leak.kind for leak in leaks] == [LeakKind.NEAR_IDENTICAL_SCENES] * is_leak
    if is_leak:
        assert leaks[0].ids == ("full-0002", "full-0099")
    assert find_leaks(with_twin(release_tables, shift_m, np.deg2rad(turn_deg), own, half_turn)) == []


def test_near_identical_scenes_leak_across_splits_of_another_scheme(release_tables: dict[str, pa.Table]) -> None:
    twins = with_twin(release_tables, 0.0, 0.0, split_in(release_tables, "full-0002"))
    apart = changed(schemas.SPLITS, twins["splits"], lambda row: row["scene_id"] == "full-0099", split_category_can="validation")
    (leak,) = find_leaks(twins | {"splits": apart})
    assert leak.kind is LeakKind.NEAR_IDENTICAL_SCENES
    assert leak.found.endswith("in train and validation of scheme category_can")


@pytest.mark.parametrize("table", ["obstacles", "targets"])
def test_one_thing_elsewhere_makes_another_scene(release_tables: dict[str, pa.Table], table: str) -> None:
    other = "train" if split_in(release_tables, "full-0002") != "train" else "test"
    twins = with_twin(release_tables, 0.0, 0.0, other)
    prefix = {"obstacles": "obstacle", "targets": "target"}[table]
    schema = schemas.ALL_SCHEMAS[table]
    moved = changed(schema, twins[table], lambda row: row["scene_id"] == "full-0099", **{f"{prefix}_y_m": 0.9})
    assert find_leaks(twins | {table: moved}) == []


def test_the_object_turned_makes_another_scene(release_tables: dict[str, pa.Table]) -> None:
    twins = with_twin(release_tables, 0.0, 0.0, "test" if split_in(release_tables, "full-0002") != "test" else "train")
    twin = next(row for row in twins["scenes"].to_pylist() if row["scene_id"] == "full-0099")
    turned = {name: value for name, value in shift_and_turn(twin, "object", 0.0, 0.2).items() if name.startswith("object_q")}
    moved = changed(schemas.SCENES, twins["scenes"], lambda row: row["scene_id"] == "full-0099", **turned)
    assert find_leaks(twins | {"scenes": moved}) == []


@given(st.integers(0, 2**32 - 1), st.sampled_from(list(Symmetry)))
@settings(max_examples=60, deadline=None)
def test_turns_agree_with_the_object_model(seed: int, symmetry: Symmetry) -> None:
    """The batch form against the one pair at a time that validation uses."""
    R = Rotation.random(6, random_state=seed % 2**31).as_matrix()
    object_model = ObjectModel.__new__(ObjectModel)
    object.__setattr__(object_model, "symmetry", symmetry)
    expected = [[object_model.rotation_error_rad(a, b) for b in R[3:]] for a in R[:3]]
    # Both are arc tangents of sums of products of unit vectors: rounding only.
    np.testing.assert_allclose(_turn_rad(R[:3, None], R[None, 3:], symmetry), expected, atol=1e-9)


@given(st.integers(1, 5).flatmap(lambda n: st.lists(st.lists(st.booleans(), min_size=n, max_size=n), min_size=n, max_size=n)))
@settings(max_examples=100, deadline=None)
def test_matching_agrees_with_trying_every_pairing(rows: list[list[bool]]) -> None:
    n = len(rows)
    brute = any(all(rows[i][order[i]] for i in range(n)) for order in permutations(range(n)))
    assert _is_matching(np.array(rows)) == brute
