"""Heavy tables of a real release, made again from the light one: the same bytes, or nothing at all."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pipelines.running.data_root import DataRoot
from splits import rebuild as command
from splits.manifest import read_manifest
from splits.origin import recipe_of
from splits.rebuild import rebuild
from splits.release import make_light, verify_release
from splits.release_reader import Release
from tables.schemas import ALL_SCHEMAS, PLANS
from tables.store import read_table, table_from_rows, write_table
from tests.assets_def.conftest import Built
from tests.assets_def.small import SHARD, TIER, small_benchmark
from tests.splits.damage import contents, read_json, republished, without, write_signed

REBUILT = ("plans", "scene_points", "scene_attempts")


@pytest.fixture
def whole(built: Built) -> Path:
    return small_benchmark(built.folder).root.release(TIER)


@pytest.fixture
def recipe(built: Built) -> Path:
    return Path(small_benchmark(built.folder).recipe_path)


@pytest.fixture
def light(whole: Path, tmp_path: Path) -> Path:
    make_light(whole, tmp_path / "light")
    return tmp_path / "light"


def files(directory: Path) -> dict[str, bytes]:
    return contents(directory)


def test_every_heavy_table_but_timings_comes_out_byte_for_byte(whole: Path, light: Path, recipe: Path) -> None:
    assert Release.open(whole).table("plans").num_rows, "at least one candidate must be planned, else nothing is shown"
    lines: list[str] = []
    for n_workers, name in enumerate(REBUILT):  # in this process, in one worker, in two
        rebuild(light, name, n_workers, recipe, lines.append)
    assert files(light) == {name: content for name, content in files(whole).items() if not name.startswith("timings.")}
    verify_release(light, may_be_light=True)
    assert Release.open(light).left_out == ("timings",)
    assert not [path for path in light.parent.iterdir() if path != light], "the work folder is gone"
    assert sum("as in the manifest" in line for line in lines) == len(REBUILT)
    rebuild(light, "plans", 0, recipe, lines.append)
    assert lines[-1] == "plans: there already"


def test_a_killed_rebuild_goes_on_where_it_was(light: Path, recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(command, "read_tables", killed)
        assert command.main([str(light), "plans", "--workers", "0", "--recipe", str(recipe)]) == 130
    lines: list[str] = []
    rebuild(light, "plans", 0, recipe, lines.append)
    assert lines[0].startswith(f"{SHARD}: kept, 1 of 1 shards")
    assert verify_release(light, may_be_light=True)


def test_a_flipped_value_is_refused(whole: Path, light: Path, recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last bit of one number of one plan, in a table whose sidecar fits it."""
    run_stage = command.run_stage

    def flipping(stage, shard, root: DataRoot, *arguments, **named):
        report = run_stage(stage, shard, root, *arguments, **named)
        path = root.shard_table(shard, "plans")
        rows, made_from = read_table(PLANS, path).to_pylist(), report.sidecars["plans"].made_from
        rows[0]["place_q_3_rad"] *= 1.0 + 2.0**-52
        write_table(PLANS, table_from_rows(PLANS, rows), path, made_from, of=shard)
        return report

    content = read_json(light / "manifest.json")
    content["libraries"]["ompl"] = "1.0"
    write_signed(light, content)
    before = files(light)
    with monkeypatch.context() as patched:
        patched.setattr(command, "run_stage", flipping)
        with pytest.raises(
            command.ReleaseError,
            match=r"plans made again: content hash \w{12} of \d+ rows, .* \(made with ompl 1\.0, here [\d.]+\); nothing",
        ):
            rebuild(light, "plans", 0, recipe, lambda _: None)
    assert files(light) == before
    assert not [path for path in light.parent.iterdir() if path != light], "the next run starts anew"
    rebuild(light, "plans", 0, recipe, lambda _: None)
    assert (light / "plans.parquet").read_bytes() == (whole / "plans.parquet").read_bytes()


def test_a_label_that_planning_does_not_confirm_is_named(light: Path, recipe: Path) -> None:
    """Someone edited a label and made every checksum fit: planning again says so."""
    table = Release.open(light).table("candidates")
    rows = table.to_pylist()
    row = next(row for row in rows if row["y_plan"])
    row["n_goals"] += 1
    republished(light, "candidates", table_from_rows(ALL_SCHEMAS["candidates"], rows))
    with pytest.raises(command.ReleaseError, match=rf"planning_labels made again with plans: row 0 \({row['candidate_id']}\) has n_goals"):
        rebuild(light, "plans", 0, recipe, lambda _: None)


def test_another_recipe_or_stage_is_refused_before_any_work(
    light: Path, recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.toml"
    other.write_text("[grasp_admission]\nquota = 3\n")
    assert command.main([str(light), "points", "--recipe", str(other)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("not rebuilt: recipe_hash of the release is ")
    assert "use what made it (commit " in line
    content = read_json(light / "manifest.json")
    content["provenance"]["code.scene_points"] = "0"
    write_signed(light, content)
    with pytest.raises(command.ReleaseError, match=r"code\.scene_points of the release is 0, must be that of this code, "):
        recipe_of(read_manifest(light), recipe, [command._STAGE_OF["scene_points"]])
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_what_cannot_be_made_again_or_never_was_there_is_refused(whole: Path, light: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command.main([str(light), "timings"])
    assert "invalid choice: 'timings'" in capsys.readouterr().err
    shutil.copytree(whole, light, dirs_exist_ok=True)
    without("plans")(light)
    assert command.main([str(light), "plans"]) == 1
    assert "table 'plans' is not in this release" in capsys.readouterr().err
