"""A release without its heavy tables opens, verifies and says what it lacks; anything else that is missing is still an error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pytest

from model.errors import InputError
from model.release_tables import read_table_columns
from reports.load import load_release
from splits.errors import ReleaseError
from splits.manifest import MANIFEST, files_of_table, read_manifest
from splits.release import main, make_light, verify_release, write_release
from splits.release_reader import Release
from tables import schemas
from tests.model.synthetic_release import TOLERANCES
from tests.splits.changed import changed
from tests.splits.damage import PROVENANCE, TRAIN_FILE, contents, copy_of, relisted, republished, rewritten

LEFT_OUT = ("scene_points", "timings")  # of the heavy tables those that the synthetic release has


@pytest.fixture(scope="module")
def light(release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tests that change it copy it first."""
    directory = tmp_path_factory.mktemp("light") / "made" / "here"
    make_light(release, directory)
    return directory


def test_a_light_release_is_the_whole_one_without_its_heavy_tables(release: Path, light: Path) -> None:
    absent = {file for name in LEFT_OUT for file in files_of_table(name)}
    assert contents(light) == {name: content for name, content in contents(release).items() if name not in absent}
    assert read_manifest(light) == read_manifest(release)
    assert set(LEFT_OUT) <= read_manifest(light).tables.keys(), "the manifest still says what the tables are"


@pytest.mark.parametrize("verify", [False, True])
def test_it_opens_and_names_the_command_where_a_heavy_table_is_asked_for(light: Path, verify: bool) -> None:
    opened = Release.open(light, verify=verify)
    assert opened.left_out == LEFT_OUT
    assert opened.tables().keys() == opened.manifest.tables.keys() - set(LEFT_OUT)
    assert opened.scene("full-0000").scene_id == "full-0000"
    with pytest.raises(ReleaseError, match=rf"'scene_points' is left out of this light release; `python -m splits.rebuild {light} points`"):
        opened.table("scene_points")
    with pytest.raises(ReleaseError, match="'timings' is left out of this light release; it was measured once"):
        opened.tables("scenes", "timings")
    with pytest.raises(InputError, match=rf"scene_points\.parquet: missing, .* `python -m splits.rebuild {light} points` makes it again"):
        read_table_columns(light, "scene_points", ["x_m"])


def test_reports_read_what_is_there(light: Path, release_tables: dict[str, pa.Table]) -> None:
    assert load_release(light).keys() == release_tables.keys() - set(LEFT_OUT)
    with pytest.raises(ReleaseError, match="left out"):
        load_release(light, ["scenes", "scene_points"])


def test_it_is_verified_on_request_only(release: Path, light: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(light)]) == 1
    assert "scene_points.parquet: missing; a light release, which leaves out scene_points, timings, is verified with --light" in (
        capsys.readouterr().err
    )
    assert main(["verify", str(light), "--light"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("sound: placebench pilot 0.1.0, 9 tables")
    assert f"light: without scene_points, timings\npython -m splits.rebuild {light} points\n" in out
    assert main(["verify", str(release), "--light"]) == 0
    assert "light" not in capsys.readouterr().out


DAMAGES: list[tuple[str, Callable[[Path], object], str]] = [
    ("another table", lambda d: [(d / file).unlink() for file in files_of_table("targets")], r"targets\.parquet: missing"),
    ("a split", lambda d: (d / TRAIN_FILE).unlink(), r"candidates/split=train/part-0\.parquet: missing"),
    ("the card", lambda d: (d / "README.md").unlink(), r"README\.md: missing"),
    ("a byte", rewritten("grasps.parquet", lambda b: b[:100] + b"?" + b[101:]), r"grasps\.parquet: SHA-256"),
    ("a stranger", lambda d: (d / "notes.txt").write_text("mine"), r"notes\.txt: not in the manifest"),
    ("half a heavy table", lambda d: (d / "scene_points.parquet").write_bytes(b"PAR1"), r"scene_points\.parquet: 4 bytes, manifest says"),
    ("a datasheet of other data", relisted("DATASHEET.md", lambda b: b.replace(b"pilot", b"full", 1)), r"DATASHEET\.md: line 1 is"),
]


@pytest.mark.parametrize(("damage", "message"), [pytest.param(d, m, id=name) for name, d, m in DAMAGES])
def test_any_other_damage_is_found(light: Path, tmp_path: Path, damage: Callable[[Path], object], message: str) -> None:
    directory = copy_of(light, tmp_path)
    damage(directory)
    with pytest.raises(ReleaseError, match=message):
        verify_release(directory, may_be_light=True)


def test_an_impossible_label_is_found_without_the_heavy_tables_too(
    light: Path, release_tables: dict[str, pa.Table], tmp_path: Path
) -> None:
    directory = copy_of(light, tmp_path)
    republished(directory, "candidates", changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: row["y_plan"], y_plan=False))
    with pytest.raises(ReleaseError, match=r"laws: .* y_plan says the same as plan_status"):
        verify_release(directory, may_be_light=True)


def test_a_light_copy_is_made_of_a_sound_release_in_a_folder_of_its_own(release: Path, light: Path, tmp_path: Path) -> None:
    damaged = copy_of(release, tmp_path)
    rewritten("scene_points.parquet", lambda b: b[:100] + bytes([b[100] ^ 1]) + b[101:])(damaged)
    with pytest.raises(ReleaseError, match=r"scene_points\.parquet: SHA-256"):
        make_light(damaged, tmp_path / "of damaged")
    before = contents(release)
    for folder in (release, release / "light", release.parent):
        with pytest.raises(ReleaseError, match="neither the release itself nor in it nor around it"):
            make_light(release, folder)
    assert contents(release) == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    with pytest.raises(ReleaseError, match=r"notes\.txt: not a file of a release"):
        make_light(release, tmp_path / "mine")
    make_light(light, tmp_path / "twice")
    assert verify_release(tmp_path / "twice", may_be_light=True) == read_manifest(release)


def test_a_light_copy_replaces_a_whole_release(release: Path, release_tables: dict[str, pa.Table], light: Path, tmp_path: Path) -> None:
    write_release(release_tables, tmp_path, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    make_light(release, tmp_path)
    assert contents(tmp_path) == contents(light)
    assert (tmp_path / MANIFEST).exists()


def test_texts_are_made_again_and_tables_stay(light: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    directory = copy_of(light, tmp_path)
    relisted("DATASHEET.md", lambda b: b.replace(b"pilot", b"full", 1))(directory)
    (directory / "README.md").unlink()
    assert main(["render", str(directory)]) == 0
    assert contents(directory) == contents(light)
    assert "sound: placebench pilot 0.1.0" in capsys.readouterr().out
    rewritten("grasps.parquet", lambda b: b[:100] + bytes([b[100] ^ 1]) + b[101:])(directory)
    assert main(["render", str(directory)]) == 1
    assert "not sound: grasps" in capsys.readouterr().err
