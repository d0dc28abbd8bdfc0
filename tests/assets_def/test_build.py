"""The command line: what a step says, what is skipped, and every way to fail in one line."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from dagster import (
    AssetCheckResult,
    AssetCheckSpec,
    AssetKey,
    AssetsDefinition,
    DagsterInstance,
    ExecuteInProcessResult,
    MaterializeResult,
    asset,
    materialize,
)
from rich.console import Console

from assets_def import build as command
from assets_def.checks import consistency_result
from assets_def.definitions import definitions
from assets_def.object_assets import object_assets
from assets_def.proof_assets import attempts_step
from assets_def.release_assets import release_step, release_steps
from assets_def.report_assets import profile_step, report_steps
from assets_def.resources import Benchmark
from assets_def.stages import stage_assets
from model.errors import RankerError
from objects.catalogue import load_catalogue
from objects.provenance import catalogue_sources
from pipelines.recipe import RecipeError
from reports.load import Task
from reports.policies import POLICIES, RANKER
from splits.manifest import read_manifest
from splits.release import ReleaseError
from tables.files import file_sha256
from tables.identity import IdentityError
from tables.schemas import ALL_SCHEMAS, ATTEMPTS, OBJECT_TABLES
from tables.store import StoreError, read_sidecar, read_table, sidecar_path, table_from_rows, write_table
from tests.assets_def.conftest import Built, run
from tests.assets_def.small import SHARD, TIER, SmallBenchmark, small_benchmark
from tests.assets_def.test_instance import YAML


@pytest.fixture(autouse=True)
def _home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A Dagster instance of each test's own."""
    (tmp_path / "home").mkdir()
    shutil.copy(YAML, tmp_path / "home")
    monkeypatch.setenv("DAGSTER_HOME", str(tmp_path / "home"))


@pytest.fixture
def out(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """What the command prints, in colour."""
    text = io.StringIO()
    for name in ("CONSOLE", "ERRORS"):
        monkeypatch.setattr(command, name, Console(file=text, width=80, force_terminal=True, color_system="standard"))
    return text


def red_lines(text: io.StringIO) -> list[str]:
    """Lines in red, without the colour; asserts that nothing looks like a traceback."""
    assert "Traceback" not in text.getvalue()
    return re.findall(r"\x1b\[31m(.*?)\x1b\[0m\n", text.getvalue())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["mini", "--workers", "-2"], "argument --workers: -2, must be a whole number of at least 0"),
        (["mini", "--workers", "two"], "argument --workers: two, must be a whole number of at least 0"),
        (["nano"], "argument tier: invalid choice: 'nano' (choose from 'mini', 'pilot', 'full')"),
        (["mini", "--until", "tomorrow"], "argument --until: invalid choice"),
        ([], "the following arguments are required: tier"),
    ],
)
def test_a_wrong_command_is_one_red_line_and_exit_code_2(arguments: list[str], words: str, out: io.StringIO) -> None:
    with pytest.raises(SystemExit) as ended:
        command.main(arguments)
    assert ended.value.code == 2
    (line,) = red_lines(out)
    assert words in line


@pytest.mark.parametrize(
    ("recipe", "words"),
    [
        ("[planning]\nhope = 1\n", "recipe.planning.hope: unknown key"),
        ('[camera]\nwidth_px = "many"\n', "recipe.camera"),
        ("[planning\n", "Expected ']'"),
    ],
    ids=["unknown key", "wrong value", "no TOML"],
)
def test_a_broken_recipe_is_one_red_line_and_exit_code_1(
    recipe: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: io.StringIO
) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text(recipe)
    monkeypatch.setattr(command, "Benchmark", partial(Benchmark, data_dir=str(tmp_path / "data"), recipe_path=str(path)))
    assert command.main(["mini"]) == 1
    (line,) = red_lines(out)
    assert line.startswith("RecipeError: ")
    assert words in line


def test_a_missing_table_is_one_red_line_and_exit_code_1(
    built: Built, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: io.StringIO
) -> None:
    benchmark = built.copy(tmp_path / "small")
    sidecar_path(benchmark.root.shard_table(SHARD, "candidate_pairs")).unlink()
    monkeypatch.setattr(command, "build", lambda tier, _, until: command._build_steps(tier, benchmark, until))
    assert command.main(["mini"]) == 1
    (line,) = red_lines(out)
    assert re.fullmatch(r"StoreError: .*candidate_pairs\.parquet: not published \(table or sidecar missing\)", line)


@pytest.mark.parametrize("error", [StoreError, RecipeError, ReleaseError, RankerError, IdentityError, command.BuildError])
def test_every_error_on_purpose_is_one_red_line(error: type[Exception], monkeypatch: pytest.MonkeyPatch, out: io.StringIO) -> None:
    def fail(*_: object) -> None:
        raise error("scenes: 1 row,\n  must be 2")

    monkeypatch.setattr(command, "build", fail)
    assert command.main(["mini"]) == 1
    (line,) = red_lines(out)
    assert line.endswith("scenes: 1 row, must be 2")


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch, out: io.StringIO) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(command, "build", fail)
    with pytest.raises(ZeroDivisionError):
        command.main(["mini"])


def test_an_interrupted_build_says_in_its_last_line_what_is_kept(monkeypatch: pytest.MonkeyPatch, out: io.StringIO) -> None:
    def interrupted(*_: object) -> None:
        with command._line("scenes"):
            command._reason(_result(_interrupting))

    monkeypatch.setattr(command, "build", interrupted)
    assert command.main(["mini"]) == command.INTERRUPTED
    (line,) = red_lines(out)
    assert "kept" in line
    assert out.getvalue().endswith(f"{line}\x1b[0m\n")


@asset
def _interrupting() -> None:
    os.kill(os.getpid(), signal.SIGINT)
    signal.pause()


@asset
def _failing() -> None:
    try:
        raise KeyError("a reason below")
    except KeyError as below:
        raise StoreError("x.parquet: not published\nwith a second line") from below


@asset
def _announcing() -> None:
    raise StoreError("1 of 19 scenes failed, must be 0:\nfull-0015 (can_06): no valid scene\nfull-0016: another")


@asset(check_specs=[AssetCheckSpec("consistent", asset="_contradicting", blocking=True)])
def _contradicting() -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    yield MaterializeResult()
    yield consistency_result("_contradicting", ["mini-0000: 7 targets, must be 8", "mini-0001: 6 targets, must be 8"])


def _result(one: AssetsDefinition) -> ExecuteInProcessResult:
    settings = {"loggers": {"console": {"config": {"log_level": "CRITICAL"}}}}
    return materialize([one], instance=DagsterInstance.ephemeral(), raise_on_error=False, run_config=settings)


def test_the_reason_of_a_failed_run_is_what_the_step_raised_or_what_its_gate_found_first() -> None:
    assert command._reason(_result(_failing)).endswith(".StoreError: x.parquet: not published")
    assert command._reason(_result(_announcing)).endswith("failed, must be 0: full-0015 (can_06): no valid scene")
    assert command._reason(_result(_contradicting)) == "check _contradicting.consistent: mini-0000: 7 targets, must be 8"


def test_until_release_is_the_release_and_its_profile() -> None:
    names = [name for _, _, name in command._steps("mini", "release")]
    assert names == ["candidates and grasps", "splits", "release", "profile report"]


def test_until_reports_is_every_asset_above_the_shards_each_before_what_reads_it() -> None:
    graph = definitions.resolve_asset_graph()
    below = {key for assets in (object_assets, *stage_assets) for key in assets.keys}
    order = list(dict.fromkeys(key for step, _, _ in command._steps("full", "reports") for key in step.asset.keys))
    # Films are made where they are asked for: minutes for what no number depends on.
    assert set(order) == graph.executable_asset_keys - below - {AssetKey("sample_films")}
    for k, key in enumerate(order):
        assert graph.get(key).parent_keys <= below | {AssetKey("sample_films")} | set(order[:k]) | _same_step(key), key
    assert sum(step.name == "ranker" for step, _, _ in command._steps("full", "reports")) == 18


def _same_step(key: AssetKey) -> set[AssetKey]:
    return {other for step, _, _ in command._steps("mini", "reports") if key in step.asset.keys for other in step.asset.keys}


def outcomes(text: io.StringIO) -> dict[str, str]:
    """What became of each step, line by line; every line ends with its time."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", text.getvalue())
    text.seek(0)
    text.truncate()
    lines = [re.fullmatch(r"(.{36})(up to date|made) +\d+\.\d s", line) for line in plain.splitlines()]
    return {line.group(1).strip(): line.group(2) for line in lines if line is not None}


def test_what_is_up_to_date_is_skipped_and_what_is_not_is_made(built: Built, tmp_path: Path, out: io.StringIO) -> None:
    benchmark = built.copy(tmp_path / "small")
    names = ["candidates and grasps", "splits", "release", "profile report"]
    command._build_steps(TIER, benchmark, "release")
    assert outcomes(out) == dict(zip(names, ["up to date"] * 3 + ["made"], strict=True))
    command._build_steps(TIER, benchmark, "release")
    assert outcomes(out) == dict.fromkeys(names, "up to date")
    with DagsterInstance.get() as instance:
        assert [run.job_name for run in instance.get_runs()] == ["reports"], "what is up to date starts no run"

    # The release is made again; it is the same release, so that its report stays.
    (benchmark.root.release(TIER) / "manifest.json").unlink()
    command._build_steps(TIER, benchmark, "release")
    assert outcomes(out) == dict.fromkeys(names, "up to date") | {"release": "made"}

    # A damaged picture costs its report and nothing else.
    (benchmark.report_dir(TIER) / "profile-funnel.png").write_bytes(b"")
    command._build_steps(TIER, benchmark, "release")
    assert outcomes(out) == dict.fromkeys(names, "up to date") | {"profile report": "made"}


def test_objects_that_are_up_to_date_start_no_run_and_a_red_gate_is_not_passed_by(built: Built, tmp_path: Path, out: io.StringIO) -> None:
    """The two objects of the small benchmark, with the origins that the whole catalogue would give them."""
    benchmark = built.copy(tmp_path / "small")
    recipe = benchmark.recipe("full")
    sources = catalogue_sources(load_catalogue(), recipe.objects, recipe.seed)
    tables = {name: read_table(ALL_SCHEMAS[name], benchmark.root.object_table(name)) for name in OBJECT_TABLES}
    for name, table in tables.items():
        write_table(ALL_SCHEMAS[name], table, benchmark.root.object_table(name), sources)
    command._build_objects(benchmark)
    assert outcomes(out) == {"objects": "up to date"}
    with DagsterInstance.get() as instance:
        assert instance.get_runs_count() == 0

    # A repeated key that a sidecar of its own vouches for.
    path = benchmark.root.object_table("stable_poses")
    pq.write_table(pa.concat_tables([tables["stable_poses"]] * 2), path)
    sidecar = json.loads(sidecar_path(path).read_text())
    sidecar_path(path).write_text(json.dumps(sidecar | {"sha256": file_sha256(path), "rows": 2 * sidecar["rows"]}))
    with pytest.raises(command.BuildError, match=r"check stable_poses\.schema: .*repeated keys"):
        command._build_objects(benchmark)


def test_other_labels_make_what_reads_them_again(built: Built, tmp_path: Path) -> None:
    benchmark = built.copy(tmp_path / "small")
    path = benchmark.root.shard_table(SHARD, "policy_features")
    rows = read_table(ALL_SCHEMAS["policy_features"], path).to_pylist()
    rows[0]["ik_feasible"] = not rows[0]["ik_feasible"]
    write_table(ALL_SCHEMAS["policy_features"], table_from_rows(ALL_SCHEMAS["policy_features"], rows), path)
    done = {step.name: step.is_done(benchmark, TIER) for step in release_steps}
    assert done == {"candidates and grasps": True, "splits": True, "release": False}


def test_attempts_are_released_once_they_are_of_todays_labels(built: Built, tmp_path: Path) -> None:
    """Those that are there are made up, and say of nothing what they were made from."""
    benchmark = built.copy(tmp_path / "small")
    before = read_manifest(benchmark.root.release(TIER))
    assert "attempts" not in before.tables
    assert release_step.is_done(benchmark, TIER)
    path = benchmark.root.tier_table(TIER, "attempts")
    table, candidates = read_table(ATTEMPTS, path), read_sidecar(benchmark.root.tier_table(TIER, "candidates"))
    recipe_hash = benchmark.recipe_of_tier(TIER).hash_of()
    for made_from in (
        {"table.candidates": candidates.content_hash, "recipe": "another"},
        {"table.candidates": "another", "recipe": recipe_hash},
    ):
        write_table(ATTEMPTS, table, path, made_from, of=TIER)
        assert release_step.is_done(benchmark, TIER), made_from
    write_table(ATTEMPTS, table, path, {"table.candidates": candidates.content_hash, "recipe": recipe_hash}, of=TIER)
    assert not release_step.is_done(benchmark, TIER)
    assert run([release_step.asset], TIER, benchmark).success
    after = read_manifest(benchmark.root.release(TIER))
    assert after.tables["attempts"].content_hash == read_sidecar(path).content_hash
    assert after.release_hash == before.release_hash, "what was made from the release stays current"
    assert release_step.is_done(benchmark, TIER)
    (product,) = attempts_step.products(benchmark, TIER)
    assert {"table.candidates", "recipe"} <= product.made_from.keys()  # type: ignore[attr-defined]


def test_a_reused_report_is_shown_whole(built: Built, tmp_path: Path) -> None:
    benchmark = built.copy(tmp_path / "small")
    steps = [step for step in report_steps if step.name in ("profile report", "shard_diagnostics report")]
    made, kept = ([_materialization(step.asset, benchmark) for step in steps] for _ in range(2))
    for first, second in zip(made, kept, strict=True):
        assert (first.pop("reused"), second.pop("reused")) == (False, True)
        assert first == second
        assert "report" in first
    assert made[0]["n_shards"] == 1.0
    assert any(name.startswith("figure profile") for name in made[1])
    assert profile_step.is_done(benchmark, TIER)


def _materialization(assets: AssetsDefinition, benchmark: SmallBenchmark) -> dict[str, object]:
    (event,) = run([assets], TIER, benchmark).get_asset_materialization_events()
    return {name: value.value for name, value in event.materialization.metadata.items()}


def test_the_last_words_fit_a_terminal_of_80_columns(tmp_path: Path, out: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even where every number has its longest form."""
    benchmark = small_benchmark(tmp_path)
    directory = benchmark.report_dir(TIER)
    directory.mkdir(parents=True)
    ends = {"": 1.0, "_low": 0.984, "_high": 1.0}
    names = [f"test.{task}.{policy.name}" for task in Task for policy in POLICIES]
    (directory / "success_at_k.json").write_text(json.dumps({f"{name}.s1{end}": value for name in names for end, value in ends.items()}))
    monkeypatch.chdir(tmp_path)
    command._print_result(TIER, "reports", benchmark)
    plain = re.sub(r"\x1b\[[0-9;]*m", "", out.getvalue())
    assert "paper" not in plain, "with a recipe of its own it is no benchmark"
    command.CONSOLE.print(command._ladder(TIER, directory / "success_at_k.json", has_paper=True))
    of_benchmark = re.sub(r"\x1b\[[0-9;]*m", "", out.getvalue())[len(plain) :]
    for shown in (plain, of_benchmark):
        assert max(map(len, shown.splitlines())) <= 80
        assert "…" not in shown
        for policy in POLICIES:
            (row,) = [line for line in shown.splitlines() if line.startswith(policy.label)]
            assert row.count("100.0 [98.4, 100.0]") == 2
            assert ("85.78" in row and "79.67" in row) == (policy is RANKER and shown is of_benchmark)
    (site,) = [line.split()[1] for line in plain.splitlines() if line.startswith("site ")]
    assert (tmp_path / site) == directory / "site" / "index.html"
