"""Damage by someone who makes every checksum fit: what the fields and the tables say is judged all the same, one line each."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from splits.errors import ReleaseError
from splits.manifest import CARD, MANIFEST, read_manifest
from splits.release import REQUIRED_TABLES, verify_release
from tables import schemas
from tests.splits.changed import changed
from tests.splits.damage import Damage, answer, copy_of, dropped, listed, relisted, republished, sidecar, signed, swapped, without


def foreign_file_listed(directory: Path) -> None:
    (directory / "a.txt").write_text("x")
    listed(directory, "a.txt")


def swapped_and_relisted(a: str, b: str) -> Damage:
    def damage(directory: Path) -> None:
        swapped(a, b)(directory)
        listed(directory, a, b)

    return damage


# What someone writes who makes every checksum fit.
SIGNED: list[tuple[str, Damage, list[str]]] = [
    ("another name", signed("name", to="other"), ["name 'other', must be 'placebench'"]),
    ("a name of two lines", signed("name", to="place\nbench"), [r"name 'place\nbench', must be"]),
    ("an unknown tier", signed("tier", to="bogus"), ["tier: 'bogus' is not a tier", "mini, pilot or full"]),
    ("a tier that is no text", signed("tier", to=["pilot"]), ["tier: ['pilot'] is not a text"]),
    ("another tier", signed("tier", to="mini"), ["of 'pilot', manifest says 'mini'"]),
    ("another licence", signed("licence", to="MIT"), ["licence 'MIT', must be 'CC-BY-4.0'"]),
    ("no licence", signed("licence", to=None), ["licence None, must be"]),
    ("a version of two numbers", signed("version", to="0.1"), ["version '0.1', must be major.minor.patch"]),
    ("a version with a zero before", signed("version", to="0.01.0"), ["version '0.01.0', must be major.minor.patch"]),
    ("a version that is a number", signed("version", to=0.1), ["version 0.1, must be major.minor.patch"]),
    (
        "newer data",
        signed("version", to="1.0.0"),
        ["version 1.0.0 is of a newer major version than this code knows (0.3.0)", "newer PlaceBench"],
    ),
    (
        "a newer schema",
        signed("schema_version", to="3.0.0"),
        ["schema_version 3.0.0 is of a newer major version than this code knows (2.0.0)"],
    ),
    ("another schema", signed("schema_version", to="2.1.0"), ["schema_version 2.1.0, this code reads 2.0.0 only"]),
    ("an older schema", signed("schema_version", to="0.9.0"), ["schema_version 0.9.0, this code reads 2.0.0 only"]),
    ("a schema version that is a number", signed("schema_version", to=1), ["schema_version 1, must be major.minor.patch"]),
    ("no version", dropped("version"), ["version None, must be major.minor.patch"]),
    ("newer data of other fields", lambda d: (dropped("licence")(d), signed("version", to="7.0.0")(d)), ["newer major version"]),
    ("a tolerance that is a text", signed("position_tolerance_m", to="0.02"), ["position_tolerance_m '0.02', must be a number in (0, 1]"]),
    ("a tolerance that is true", signed("position_tolerance_m", to=True), ["position_tolerance_m True, must be a number"]),
    ("a tolerance of 0", signed("rotation_tolerance_rad", to=0), ["rotation_tolerance_rad 0, must be a number in (0, 3.142]"]),
    ("a tolerance below 0", signed("position_tolerance_m", to=-0.02), ["position_tolerance_m -0.02, must be a number"]),
    ("a tolerance in degrees", signed("rotation_tolerance_rad", to=10), ["rotation_tolerance_rad 10, must be a number in (0, 3.142]"]),
    ("a tighter tolerance", signed("position_tolerance_m", to=0.0075), ["labels:", "tolerance_margin is 1 minus", "0.0075 m"]),
    ("a tolerance missing", dropped("position_tolerance_m"), ["fields: missing ['position_tolerance_m']"]),
    ("an unknown field", signed("mood", to="good"), ["fields: missing [], unknown ['mood']"]),
    ("provenance that is a list", signed("provenance", to=[]), ["provenance [], must be an object of texts"]),
    ("provenance that is a number", signed("provenance", "code.scenes", to=2), ["provenance.code.scenes 2", "must be texts"]),
    ("provenance that is empty", signed("provenance", "code.scenes", to=" "), ["provenance.code.scenes ' '", "not empty"]),
    ("other provenance", signed("provenance", "git_commit", to="unknown"), ["candidates.parquet.json: made_from", "manifest says"]),
    ("libraries that are a text", signed("libraries", to="numpy 2"), ["libraries 'numpy 2', must be an object of texts"]),
    ("a library without a version", signed("libraries", "numpy", to=None), ["libraries.numpy None", "must be texts"]),
    ("tables that are a list", signed("tables", to=[]), ["tables [], must be an object of entries"]),
    ("tables that are none", signed("tables", to={}), ["files: missing [], unknown ['candidates.parquet'"]),
    ("a table that is a text", signed("tables", "targets", to="x"), ["tables.targets 'x', must be an object with"]),
    ("a table without rows", dropped("tables", "targets", "rows"), ["tables.targets: missing ['rows']"]),
    ("a table with more", signed("tables", "targets", "mood", to=1), ["tables.targets: missing [], unknown ['mood']"]),
    ("rows that are a text", signed("tables", "targets", "rows", to="96"), ["tables.targets: rows '96', must be a whole number"]),
    ("rows below 0", signed("tables", "targets", "rows", to=-1), ["tables.targets: rows -1, must be a whole number of at least 0"]),
    ("rows that are true", signed("tables", "targets", "rows", to=True), ["tables.targets: rows True, must be a whole number"]),
    ("other rows", signed("tables", "targets", "rows", to=95), ["targets.parquet.json: rows 96, manifest says 95"]),
    (
        "a content hash that is none",
        signed("tables", "targets", "content_hash", to="x"),
        ["tables.targets: content_hash 'x', must be 64 hex"],
    ),
    ("another content hash", signed("tables", "targets", "content_hash", to="0" * 64), ["release_hash", "must be"]),
    ("a file outside", signed("tables", "targets", "file", to="../t.parquet"), ["file '../t.parquet', must be 'targets.parquet'"]),
    (
        "a file of another table",
        signed("tables", "targets", "file", to="scenes.parquet"),
        ["file 'scenes.parquet', must be 'targets.parquet'"],
    ),
    ("another release hash", signed("release_hash", to="0" * 64), ["release_hash '0000", "must be '"]),
    ("a release hash that is a list", signed("release_hash", to=[]), ["release_hash [], must be '"]),
    ("files that are a list", signed("files", to=[]), ["files [], must be an object of entries"]),
    ("a file not listed", dropped("files", "targets.parquet"), ["files: missing ['targets.parquet']"]),
    ("a card not listed", dropped("files", CARD), [f"files: missing ['{CARD}']"]),
    ("an unknown file listed", foreign_file_listed, ["unknown ['a.txt']"]),
    ("a size that is a text", signed("files", CARD, "bytes", to="1 kB"), [f"files.{CARD}: bytes '1 kB', must be a whole number"]),
    ("another size", signed("files", CARD, "bytes", to=1), [f"{CARD}: ", "bytes, manifest says 1"]),
    ("a SHA-256 in capitals", signed("files", CARD, "sha256", to="A" * 64), [f"files.{CARD}: sha256 'AAA", "must be 64 hex digits"]),
    ("another SHA-256", signed("files", CARD, "sha256", to="0" * 64), [f"{CARD}: SHA-256", "manifest says 000000000000"]),
    ("a sidecar that is no JSON", relisted("targets.parquet.json", lambda b: b"{"), ["targets.parquet.json: cannot be read as a sidecar"]),
    (
        "a sidecar that is no text",
        relisted("targets.parquet.json", lambda b: b"\xff"),
        ["targets.parquet.json: cannot be read as a sidecar"],
    ),
    ("a nested sidecar", relisted("targets.parquet.json", lambda b: b"[" * 100_000), ["targets.parquet.json: cannot be read as a sidecar"]),
    ("a sidecar that is a list", relisted("targets.parquet.json", lambda b: b"[1]"), ["targets.parquet.json: [1], must be an object"]),
    ("a sidecar without rows", sidecar("targets", rows=...), ["targets.parquet.json: missing ['rows']"]),
    ("a sidecar with more", sidecar("targets", mood=1), ["targets.parquet.json: missing [], unknown ['mood']"]),
    ("a sidecar of another table", sidecar("targets", table="scenes"), ["targets.parquet.json: table 'scenes', manifest says 'targets'"]),
    ("a sidecar of other rows", sidecar("targets", rows="96"), ["targets.parquet.json: rows '96', manifest says 96"]),
    ("a sidecar of another file", sidecar("targets", sha256="0" * 64), ["targets.parquet.json: sha256 '000", "manifest says"]),
    ("a sidecar of another schema", sidecar("targets", schema_version="0.9.0"), ["targets.parquet.json: schema_version '0.9.0'"]),
    ("a sidecar made from nothing", sidecar("targets", made_from={}), ["targets.parquet.json: made_from {}, manifest says"]),
    ("swapped and listed", swapped_and_relisted("scenes.parquet", "splits.parquet"), ["scenes.parquet.json: sha256", "manifest says"]),
    ("truncated and listed", relisted("candidates.parquet", lambda b: b[:2000]), ["candidates.parquet.json: sha256", "manifest says"]),
]


@pytest.mark.parametrize(("damage", "words"), [pytest.param(d, w, id=name) for name, d, w in SIGNED])
def test_a_manifest_that_fits_its_hash_is_still_judged(release: Path, tmp_path: Path, damage: Damage, words: list[str]) -> None:
    directory = copy_of(release, tmp_path)
    damage(directory)
    line = answer(directory)
    assert [word for word in words if word not in line] == [], line


def test_every_required_table_is_asked_for(release: Path, tmp_path: Path) -> None:
    for name in REQUIRED_TABLES:
        directory = copy_of(release, tmp_path)
        without(name)(directory)
        assert f"table {name!r} is not listed" in answer(directory)


def cast(table: pa.Table, column: str, to: pa.DataType) -> pa.Table:
    index = table.column_names.index(column)
    return table.set_column(index, pa.field(column, to, table.schema.field(column).nullable), table[column].cast(to))


def with_values(table: pa.Table, column: str, value: object, rows: int = 1) -> pa.Table:
    """The table with a value in its first rows, whatever its schema allows."""
    field = table.schema.field(column)
    plain = pa.string() if pa.types.is_dictionary(field.type) else field.type
    values = table[column].to_pylist()
    return table.set_column(table.column_names.index(column), field, pa.array([value] * rows + values[rows:], plain).cast(field.type))


def success_called_failure(table: pa.Table) -> pa.Table:
    return changed(schemas.CANDIDATES, table, lambda row: row["y_pipe"] is True, y_pipe=False)


def no_quaternion(table: pa.Table) -> pa.Table:
    for part in "xyzw":
        table = with_values(table, f"object_q{part}", 0.0)
    return table


def all_nullable(table: pa.Table) -> pa.Table:
    return table.cast(pa.schema([field.with_nullable(True) for field in table.schema]))


def split_twice(table: pa.Table) -> bytes:
    return parquet_of(table.append_column(table.schema.field("split"), table["split"]))


def not_utf8(table: pa.Table) -> bytes:
    """The first id holds a byte that is no text, as a broken writer would leave it."""
    ids = table["candidate_id"].combine_chunks()
    raw = pa.array([b"\xff", *ids.cast(pa.binary()).to_pylist()[1:]], pa.binary())
    texts = pa.StringArray.from_buffers(len(raw), raw.buffers()[1], raw.buffers()[2])
    return parquet_of(table.set_column(table.column_names.index("candidate_id"), table.schema.field("candidate_id"), texts))


def parquet_of(table: pa.Table) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


# (table, what becomes of it, words of the line); every checksum and the sidecar fit.
TABLES: list[tuple[str, str, Callable[[pa.Table], pa.Table | bytes], list[str]]] = [
    ("a flipped label", "candidates", success_called_failure, ["laws: 1 broken", "y_pipe says the same as exec_status"]),
    ("a scene without split", "splits", lambda t: t.slice(1), ["leakage: 1 leaks", "full-0000", "in 0 splits"]),
    ("a scene of another tier", "scenes", lambda t: with_values(t, "scene_id", "full-1000"), ["scenes: full-1000 is not in tier pilot"]),
    ("a scene id that is none", "scenes", lambda t: with_values(t, "scene_id", "kitchen"), ["scenes: kitchen is not in tier pilot"]),
    ("an unknown object", "scenes", lambda t: with_values(t, "object_id", "ghost"), ["scenes: object ghost is not in objects"]),
    ("an unknown object in the pool", "grasp_pool", lambda t: with_values(t, "object_id", "ghost"), ["grasp_pool: object ghost"]),
    ("no objects", "objects", lambda t: t.slice(0, 0), ["object", "is not in objects"]),
    ("no targets", "targets", lambda t: t.slice(0, 0), ["laws:", "must be 0"]),
    ("no quaternion", "scenes", no_quaternion, ["scenes: object of scene_id full-0000", "length 0, must be 1 (1 rows are wrong)"]),
    ("half a quaternion", "obstacles", lambda t: with_values(t, "obstacle_qw", 0.5), ["obstacles: obstacle of", "must be 1"]),
    ("an endless quaternion", "grasps", lambda t: with_values(t, "grasp_qx", -1e300), ["grasps: grasp of", "length inf, must be 1"]),
    ("no Parquet", "targets", lambda t: b"PK" * 500, ["targets.parquet: "]),
    ("an empty file", "targets", lambda t: b"", ["targets.parquet: "]),
    ("a Parquet head alone", "targets", lambda t: b"PAR1" + b"\0" * 100 + b"PAR1", ["targets.parquet: "]),
    ("single precision", "targets", lambda t: cast(t, "target_x_m", pa.float32()), ["column target_x_m is float", "must be double"]),
    ("a column that may be null", "targets", all_nullable, ["column ", "must be", "not null"]),
    ("a column missing", "candidates", lambda t: t.drop_columns(["exec_status"]), ["candidates.parquet: column exec_status is missing"]),
    ("a column more", "targets", lambda t: t.append_column("mood", [[1] * len(t)]), ["targets.parquet: column 'mood' is unknown"]),
    ("a column twice", "splits", split_twice, ["column split is there 2 times"]),
    ("columns in another order", "splits", lambda t: t.select(["split", "scene_id"]), ["another order, must be scene_id, split"]),
    ("a status that is none", "candidates", lambda t: with_values(t, "plan_status", "perhaps"), ["plan_status: 'perhaps'", "one of"]),
    ("a number that is none", "targets", lambda t: with_values(t, "target_x_m", float("nan")), ["target_x_m: 1 values", "not finite"]),
    ("a repeated key", "splits", lambda t: with_values(t, "scene_id", "full-0001"), ["splits: 1 repeated keys"]),
    ("a name that is none", "splits", lambda t: parquet_of(t).replace(b"scene_id", b"\xffcene_id"), ["splits.parquet: ", "utf-8"]),
    ("a text that is none", "candidates", not_utf8, ["candidates.parquet: ", "UTF8"]),
]


@pytest.mark.parametrize(("name", "change", "words"), [pytest.param(n, c, w, id=title) for title, n, c, w in TABLES])
def test_a_table_that_fits_its_checksums_is_still_judged(
    release: Path,
    release_tables: dict[str, pa.Table],
    tmp_path: Path,
    name: str,
    change: Callable[[pa.Table], pa.Table | bytes],
    words: list[str],
) -> None:
    directory = copy_of(release, tmp_path)
    republished(directory, name, change(release_tables[name]))
    line = answer(directory)
    assert [word for word in words if word not in line] == [], line


def test_a_table_that_nobody_knows_is_refused(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    directory = copy_of(release, tmp_path)
    republished(directory, "moods", release_tables["splits"])
    assert "table 'moods' is unknown to this code" in answer(directory)


def test_a_release_made_to_fit_without_damage_is_sound(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    """Otherwise the tests above would find the tools that damage, not the damage."""
    directory = copy_of(release, tmp_path)
    for name, table in release_tables.items():
        republished(directory, name, table)
    assert verify_release(directory).release_hash == read_manifest(release).release_hash


@pytest.fixture(scope="module")
def own_copy(release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy that every example damages and mends again."""
    return copy_of(release, tmp_path_factory.mktemp("bytes"))


# The same bytes in every run: what a Parquet library does with any footer at all is not tested here.
@given(data=st.data())
@settings(max_examples=60, derandomize=True)
def test_any_other_byte_of_a_table_that_fits_its_checksums_is_no_traceback(release: Path, own_copy: Path, data: st.DataObject) -> None:
    """Bytes that hold no value may differ; whatever else differs is one error. Most of the damage is in the footer."""
    name = data.draw(st.sampled_from(["objects", "splits", "targets"]))
    files = {file: (release / file).read_bytes() for file in (MANIFEST, f"{name}.parquet", f"{name}.parquet.json")}
    content = bytearray(files[f"{name}.parquet"])
    for position in data.draw(st.lists(st.integers(0, min(3000, len(content) - 1)), min_size=1, max_size=4)):
        content[-1 - position] = data.draw(st.integers(0, 255))
    republished(own_copy, name, bytes(content))
    try:
        verify_release(own_copy)
    except ReleaseError as error:
        assert f"{name}.parquet: " in str(error)  # noqa: PT017 (most examples raise, not all)
    finally:
        for file, before in files.items():
            (own_copy / file).write_bytes(before)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 10**6) | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


# Nothing in the folder says which libraries there were, or whether this was called 0.1.0 or 0.1.1.
_FREE = ("libraries", "version", "manifest_sha256")


def paths_of(content: object, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    if not isinstance(content, dict):
        return []
    return [own for key, value in content.items() for own in [(*path, key), *paths_of(value, (*path, key))]]


@given(data=st.data())
@settings(max_examples=300)
def test_any_other_value_of_any_field_is_found_even_when_signed(own_copy: Path, data: st.DataObject) -> None:
    manifest = (own_copy / MANIFEST).read_bytes()
    content = json.loads(manifest)
    path = data.draw(st.sampled_from([path for path in paths_of(content) if path[0] not in _FREE]))
    value = data.draw(JSON)
    before = content
    for name in path:
        before = before[name]
    assume((type(value), value) != (type(before), before))
    signed(*path, to=value)(own_copy)
    try:
        answer(own_copy)
    finally:
        (own_copy / MANIFEST).write_bytes(manifest)
