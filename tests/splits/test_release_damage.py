"""Damage that does not fit the checksums: every one is answered by one line that says what is wrong, and by exit code 1."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from splits.manifest import CARD, CROISSANT, DATASHEET, MANIFEST
from tests.splits.damage import TRAIN_FILE, Damage, answer, copy_of, edited, rewritten, swapped

HALF = slice(None, 2000)


def folder_for(name: str) -> Damage:
    def damage(directory: Path) -> None:
        (directory / name).unlink()
        (directory / name).mkdir()

    return damage


def no_folder(directory: Path) -> None:
    shutil.rmtree(directory)


def file_for_folder(directory: Path) -> None:
    shutil.rmtree(directory)
    directory.write_text("a file")


def empty_folder(directory: Path) -> None:
    shutil.rmtree(directory)
    directory.mkdir()


def link_to_nothing(directory: Path) -> None:
    (directory / "targets.parquet").unlink()
    (directory / "targets.parquet").symlink_to(directory / "gone")


# (name, damage, words of the line): the folder and its files.
FILES: list[tuple[str, Damage, list[str]]] = [
    ("no folder", no_folder, ["no such folder"]),
    ("a file for the folder", file_for_folder, ["not a folder"]),
    ("an empty folder", empty_folder, [MANIFEST, "missing", "no complete release"]),
    ("no manifest", lambda d: (d / MANIFEST).unlink(), [MANIFEST, "missing", "no complete release"]),
    ("a folder for the manifest", folder_for(MANIFEST), [MANIFEST, "cannot be read", "directory"]),
    ("no table", lambda d: (d / "targets.parquet").unlink(), ["targets.parquet: missing"]),
    ("no datasheet", lambda d: (d / DATASHEET).unlink(), [f"{DATASHEET}: missing"]),
    ("no split", lambda d: (d / TRAIN_FILE).unlink(), [f"{TRAIN_FILE}: missing"]),
    ("no card", lambda d: (d / CARD).unlink(), [f"{CARD}: missing"]),
    ("a folder for a table", folder_for("targets.parquet"), ["targets.parquet: not a file"]),
    ("a link to nothing", link_to_nothing, ["targets.parquet: missing"]),
    ("a truncated table", rewritten(TRAIN_FILE, lambda b: b[HALF]), [f"{TRAIN_FILE}: 2,000 bytes, manifest says"]),
    ("an empty table file", rewritten(TRAIN_FILE, lambda b: b""), [f"{TRAIN_FILE}: 0 bytes, manifest says"]),
    ("an edited Croissant", rewritten(CROISSANT, lambda b: b.replace(b"cr:Int32", b"cr:Int16", 1)), [f"{CROISSANT}: SHA-256"]),
    ("a longer card", rewritten(CARD, lambda b: b + b"\n"), [CARD, "bytes, manifest says"]),
    ("a word of the card", rewritten(CARD, lambda b: b.replace(b"train", b"brain")), [f"{CARD}: SHA-256", "manifest says"]),
    ("swapped tables", swapped("scenes.parquet", "targets.parquet"), ["scenes.parquet:", "bytes, manifest says"]),
    ("a foreign file", lambda d: (d / "notes.txt").write_text("mine"), ["notes.txt: not in the manifest", "must be 0"]),
    ("a hidden file", lambda d: (d / ".DS_Store").write_text("mine"), [".DS_Store: not in the manifest"]),
    ("a foreign folder", lambda d: (d / "old").mkdir(), ["old: not in the manifest"]),
    ("a foreign table", lambda d: shutil.copy(d / "targets.parquet", d / "more.parquet"), ["more.parquet: not in the manifest"]),
    (
        "a foreign file of a split",
        lambda d: shutil.copy(d / TRAIN_FILE, (d / TRAIN_FILE).with_name("b.parquet")),
        ["b.parquet: not in the"],
    ),
    ("a foreign split", lambda d: (d / "candidates" / "split=all").mkdir(), ["candidates/split=all: not in the manifest"]),
    ("a sidecar", lambda d: (d / "more.parquet.json").write_text("{}"), ["more.parquet.json: not in the manifest"]),
]

# A manifest that is no manifest, or one that was edited by hand.
MANIFESTS: list[tuple[str, Damage, list[str]]] = [
    ("an empty file", rewritten(MANIFEST, lambda b: b""), ["cannot be read as a manifest", "line 1"]),
    ("half of it", rewritten(MANIFEST, lambda b: b[HALF]), ["cannot be read as a manifest", "line"]),
    ("no UTF-8", rewritten(MANIFEST, lambda b: b"\xff\xfe" + b), ["not UTF-8", "byte 0 is 0xff"]),
    ("no JSON", rewritten(MANIFEST, lambda b: b"name: placebench\n"), ["cannot be read as a manifest"]),
    ("a list", rewritten(MANIFEST, lambda b: b"[]"), ["it is [], must be an object"]),
    ("a text", rewritten(MANIFEST, lambda b: b'"placebench"'), ["it is 'placebench', must be an object"]),
    ("nothing in it", rewritten(MANIFEST, lambda b: b"{}"), ["manifest_sha256 is missing"]),
    ("nested lists", rewritten(MANIFEST, lambda b: b"[" * 100_000), ["nested too deeply"]),
    ("nested objects", rewritten(MANIFEST, lambda b: b'{"a":' * 900 + b"1" + b"}" * 900), ["manifest_sha256 is missing"]),
    ("a long number", rewritten(MANIFEST, lambda b: b'{"a": ' + b"1" * 5000 + b"}"), ["number of 5000 digits", "at most 18"]),
    ("not a number", rewritten(MANIFEST, lambda b: b'{"a": NaN}'), ["number 'NaN', must be finite"]),
    ("an infinite number", rewritten(MANIFEST, lambda b: b'{"a": 1e999}'), ["number '1e999', must be finite"]),
    ("a repeated key", rewritten(MANIFEST, lambda b: b.replace(b"{", b'{"tier": "full", ', 1)), ["key 'tier' is repeated"]),
    ("more white space", rewritten(MANIFEST, lambda b: b.replace(b"\n", b"\r\n")), ["other white space", "byte for byte"]),
    ("no white space", rewritten(MANIFEST, lambda b: json.dumps(json.loads(b)).encode()), ["other white space"]),
    ("an escape", rewritten(MANIFEST, lambda b: b.replace(b'"pilot"', b'"\\u0070ilot"')), ["other white space, order or escapes"]),
    ("no own hash", rewritten(MANIFEST, lambda b: b.replace(b"manifest_sha256", b"manifest_sha512")), ["manifest_sha256 is missing"]),
    ("a short own hash", edited("manifest_sha256", to="abc"), ["manifest_sha256 'abc', must be 64 hex digits"]),
    ("an own hash that is none", edited("manifest_sha256", to=7), ["manifest_sha256 7, must be 64 hex digits"]),
    ("another own hash", edited("manifest_sha256", to="f" * 64), ["its fields have SHA-256", "says ffffffffffff, must be the same"]),
    *(
        (f"edited {'.'.join(path)}", edited(*path, to=value), ["its fields have SHA-256", "manifest_sha256 says", "must be the same"])
        for path, value in [
            (("name",), "other"),
            (("tier",), "full"),
            (("version",), "0.1.1"),
            (("licence",), "MIT"),
            (("schema_version",), "1.0.1"),
            (("release_hash",), "0" * 64),
            (("tolerances", "position_m"), 0.03),
            (("tolerances", "slip_rad"), "0.1"),
            (("tables", "targets", "rows"), 1),
            (("tables", "targets", "rows"), "96"),
            (("files", CARD, "sha256"), "0" * 64),
            (("provenance", "recipe_hash"), "1" * 64),
            (("provenance", "catalogue_hash"), "1" * 64),
            (("provenance", "git_commit"), "unknown"),
            (("provenance", "more"), "facts"),
            (("libraries", "numpy"), "9.9.9"),
            (("more",), "fields"),
        ]
    ),
]


@pytest.mark.parametrize(("damage", "words"), [pytest.param(d, w, id=name) for name, d, w in [*FILES, *MANIFESTS]])
def test_a_damage_is_answered_by_one_line(release: Path, tmp_path: Path, damage: Damage, words: list[str]) -> None:
    directory = copy_of(release, tmp_path)
    damage(directory)
    line = answer(directory)
    assert [word for word in words if word not in line] == [], line


@pytest.fixture(scope="module")
def own_copy(release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy that every example damages and mends again."""
    return copy_of(release, tmp_path_factory.mktemp("bytes"))


@given(data=st.data())
@settings(max_examples=200)
def test_any_other_byte_in_any_file_is_found(own_copy: Path, data: st.DataObject) -> None:
    path = data.draw(st.sampled_from(sorted(path for path in own_copy.rglob("*") if path.is_file())))
    content = path.read_bytes()
    position = data.draw(st.integers(0, len(content) - 1))
    other = data.draw(st.integers(0, 255).filter(lambda byte: byte != content[position]))
    path.write_bytes(content[:position] + bytes([other]) + content[position + 1 :])
    try:
        assert path.name in answer(own_copy)
    finally:
        path.write_bytes(content)


@given(data=st.data())
@settings(max_examples=100)
def test_any_missing_or_added_stretch_of_bytes_is_found(own_copy: Path, data: st.DataObject) -> None:
    path = data.draw(st.sampled_from(sorted(path for path in own_copy.rglob("*") if path.is_file())))
    content = path.read_bytes()
    start, stop = sorted((data.draw(st.integers(0, len(content))), data.draw(st.integers(0, len(content)))))
    added = data.draw(st.binary(max_size=20))
    damaged = content[:start] + added + content[stop:]
    assume(damaged != content)
    path.write_bytes(damaged)
    try:
        assert path.name in answer(own_copy)
    finally:
        path.write_bytes(content)
