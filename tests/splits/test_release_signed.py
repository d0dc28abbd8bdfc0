"""Damage by someone who makes every checksum fit: what the manifest and the texts say is judged all the same, one line each."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from splits.manifest import CARD, CROISSANT, DATASHEET, MANIFEST, files_of_table
from tests.splits.damage import TRAIN_FILE, Damage, answer, copy_of, dropped, listed, relisted, signed, swapped

TEST_FILE = files_of_table("candidates")[2]


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
    ("another tier", signed("tier", to="mini"), ["full-0000 is not in tier mini"]),
    ("another licence", signed("licence", to="MIT"), ["licence 'MIT', must be 'CC-BY-4.0'"]),
    ("no licence", signed("licence", to=None), ["licence None, must be"]),
    ("a version of two numbers", signed("version", to="0.1"), ["version '0.1', must be major.minor.patch"]),
    ("a version with a zero before", signed("version", to="0.01.0"), ["version '0.01.0', must be major.minor.patch"]),
    ("a version that is a number", signed("version", to=0.1), ["version 0.1, must be major.minor.patch"]),
    (
        "newer data",
        signed("version", to="1.0.0"),
        ["version 1.0.0 is of a newer major version than this code knows (0.4.0)", "newer PlaceBench"],
    ),
    (
        "a newer schema",
        signed("schema_version", to="3.0.0"),
        ["schema_version 3.0.0 is of a newer major version than this code knows (2.3.0)"],
    ),
    ("another schema", signed("schema_version", to="2.0.0"), ["schema_version 2.0.0, this code reads 2.3.0 only"]),
    ("an older schema", signed("schema_version", to="0.9.0"), ["schema_version 0.9.0, this code reads 2.3.0 only"]),
    ("a schema version that is a number", signed("schema_version", to=1), ["schema_version 1, must be major.minor.patch"]),
    ("no version", dropped("version"), ["version None, must be major.minor.patch"]),
    ("newer data of other fields", lambda d: (dropped("licence")(d), signed("version", to="7.0.0")(d)), ["newer major version"]),
    (
        "a tolerance that is a text",
        signed("tolerances", "position_m", to="0.02"),
        ["tolerances: position_m '0.02', must be a number in (0, 1]"],
    ),
    (
        "a tolerance that is a long text",
        signed("tolerances", "slip_m", to="x" * 500),
        ["tolerances: slip_m 'xxx", "must be a number in (0, 1]"],
    ),
    ("a tolerance that is true", signed("tolerances", "position_m", to=True), ["tolerances: position_m True, must be a number"]),
    ("a tolerance of 0", signed("tolerances", "rotation_rad", to=0), ["tolerances: rotation_rad 0, must be a number in (0, 3.142]"]),
    ("a tolerance below 0", signed("tolerances", "slip_m", to=-0.02), ["tolerances: slip_m -0.02, must be a number"]),
    ("a tolerance in degrees", signed("tolerances", "slip_rad", to=10), ["tolerances: slip_rad 10, must be a number in (0, 3.142]"]),
    ("a tighter tolerance", signed("tolerances", "position_m", to=0.0075), ["labels:", "tolerance_margin is 1 minus", "0.0075 m"]),
    (
        "a tighter bound on slip",
        signed("tolerances", "slip_m", to=0.0009),
        ["labels:", "a success has transport_slip_m of at most 0.0009 m"],
    ),
    ("a looser bound on slip", signed("tolerances", "slip_m", to=0.01), ["labels:", "slipped_in_hand has transport_slip_m above 0.01 m"]),
    ("a tolerance missing", dropped("tolerances", "slip_m"), ["tolerances: missing ['slip_m']"]),
    ("a tolerance more", signed("tolerances", "mood", to=1), ["tolerances: missing [], unknown ['mood']"]),
    ("tolerances that are a list", signed("tolerances", to=[]), ["tolerances [], must be an object with"]),
    ("no tolerances", dropped("tolerances"), ["fields: missing ['tolerances']"]),
    (
        "a release of before the bound on slip",
        lambda d: (dropped("tolerances")(d), signed("position_tolerance_m", to=0.02)(d)),
        ["fields: missing ['tolerances'], unknown ['position_tolerance_m']"],
    ),
    ("an unknown field", signed("mood", to="good"), ["fields: missing [], unknown ['mood']"]),
    ("provenance that is a list", signed("provenance", to=[]), ["provenance [], must be an object of texts"]),
    ("provenance that is a number", signed("provenance", "code.scenes", to=2), ["provenance.code.scenes 2", "must be texts"]),
    ("provenance that is empty", signed("provenance", "code.scenes", to=" "), ["provenance.code.scenes ' '", "not empty"]),
    ("other provenance", signed("provenance", "git_commit", to="unknown"), [f"{CARD}: line", "the data make"]),
    ("libraries that are a text", signed("libraries", to="numpy 2"), ["libraries 'numpy 2', must be an object of texts"]),
    ("a library without a version", signed("libraries", "numpy", to=None), ["libraries.numpy None", "must be texts"]),
    ("tables that are a list", signed("tables", to=[]), ["tables [], must be an object of entries"]),
    ("tables that are none", signed("tables", to={}), ["files: missing [], unknown ['candidates/split="]),
    ("a table that is a text", signed("tables", "targets", to="x"), ["tables.targets 'x', must be an object with"]),
    ("a table without rows", dropped("tables", "targets", "rows"), ["tables.targets: missing ['rows']"]),
    ("a table with more", signed("tables", "targets", "mood", to=1), ["tables.targets: missing [], unknown ['mood']"]),
    ("rows that are a text", signed("tables", "targets", "rows", to="96"), ["tables.targets: rows '96', must be a whole number"]),
    ("rows below 0", signed("tables", "targets", "rows", to=-1), ["tables.targets: rows -1, must be a whole number of at least 0"]),
    ("rows that are true", signed("tables", "targets", "rows", to=True), ["tables.targets: rows True, must be a whole number"]),
    ("other rows", signed("tables", "targets", "rows", to=95), ["targets.parquet: 96 rows, manifest says 95"]),
    (
        "a content hash that is none",
        signed("tables", "targets", "content_hash", to="x"),
        ["tables.targets: content_hash 'x', must be 64 hex"],
    ),
    ("another content hash", signed("tables", "targets", "content_hash", to="0" * 64), ["release_hash", "must be"]),
    ("a file outside", signed("tables", "targets", "files", to=["../t.parquet"]), ["files ['../t.parquet'], must be ['targets.parquet']"]),
    (
        "a file of another table",
        signed("tables", "targets", "files", to=["scenes.parquet"]),
        ["files ['scenes.parquet'], must be ['targets.parquet']"],
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
    ("swapped and listed", swapped_and_relisted("scenes.parquet", "splits.parquet"), ["scenes.parquet: column", "is missing"]),
    ("swapped splits", swapped_and_relisted(TRAIN_FILE, TEST_FILE), [f"{TRAIN_FILE}: scene full-0004 is in split test, must be in train"]),
    ("truncated and listed", relisted(TRAIN_FILE, lambda b: b[:2000]), [f"{TRAIN_FILE}: "]),
    (
        "a card of other data",
        relisted(CARD, lambda b: b.replace(b"| train |", b"| trian |")),
        [f"{CARD}: line", "trian", "the data make '| train"],
    ),
    ("a longer datasheet", relisted(DATASHEET, lambda b: b + b"more\n"), [f"{DATASHEET}: line", "is 'more', the data make None"]),
    (
        "an edited Croissant",
        relisted(CROISSANT, lambda b: b.replace(b'"cr:Float64"', b'"cr:Float32"', 1)),
        [f"{CROISSANT}: line", "Float64"],
    ),
    ("another version", signed("version", to="0.1.1"), [f"{CARD}: line", "0.1.0", "the data make", "0.1.1"]),
    ("another library", signed("libraries", "numpy", to="9.9.9"), [f"{CROISSANT}: line", "the data make", "numpy 9.9.9"]),
]


@pytest.mark.parametrize(("damage", "words"), [pytest.param(d, w, id=name) for name, d, w in SIGNED])
def test_a_manifest_that_fits_its_hash_is_still_judged(release: Path, tmp_path: Path, damage: Damage, words: list[str]) -> None:
    directory = copy_of(release, tmp_path)
    damage(directory)
    line = answer(directory)
    assert [word for word in words if word not in line] == [], line


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 10**6) | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


_FREE = ("manifest_sha256",)


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
