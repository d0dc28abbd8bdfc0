"""A dataset of foreign meshes through the real stages, and once more with an object appended to the catalogue: what was stays as it was."""

from __future__ import annotations

import dataclasses
import re
import shutil
from pathlib import Path

import pytest

from assets_def import build, ui
from assets_def.resources import REPOSITORY, Benchmark
from objects.examples.make_meshes import make_meshes
from pipelines.running.dataset_record import DatasetError, claim_dataset
from pipelines.running.object_tables import make_object_tables
from pipelines.running.shard_runner import ShardInputs, StageReport, run_stage
from pipelines.stages import STAGES
from tables.schemas import CANDIDATE_PAIRS, EXECUTION_LABELS, SCENES
from tables.store import read_sidecar, read_tables

EXAMPLES = REPOSITORY / "objects" / "examples"
# One scene of each object, beside one obstacle.
CHOSEN = ("mini-0001", "mini-0007", "mini-0013")
SHARDS = ("mini-000", "mini-001")


class FewScenes(Benchmark):
    """The stages on one scene a shard; everything else is as it is."""

    def shard_inputs(self, shard: str) -> ShardInputs:
        inputs = super().shard_inputs(shard)
        return dataclasses.replace(inputs, allocations=[a for a in inputs.allocations if a.scene_id in CHOSEN])

    def run(self, shard: str) -> list[StageReport]:
        inputs = self.shard_inputs(shard)
        return [run_stage(stage, shard, self.root, inputs, 0) for stage in STAGES]


def benchmark_of(folder: Path, objects: tuple[str, ...]) -> FewScenes:
    """Of some objects of the example catalogue, in the folder's own data root."""
    folder.mkdir(exist_ok=True)
    for mesh in EXAMPLES.glob("*.ply"):
        shutil.copy(mesh, folder)
    blocks = {block.split('"')[1]: block for block in (EXAMPLES / "own_objects.toml").read_text().split("[[object]]\n")[1:]}
    (folder / "own.toml").write_text("".join(f"[[object]]\n{blocks[name]}" for name in objects))
    (folder / "recipe.toml").write_text("[grasp_admission]\nquota = 2\n")
    names = {"catalogue_path": "own.toml", "recipe_path": "recipe.toml", "data_dir": "data"}
    benchmark = FewScenes(n_workers=0, **{field: str(folder / name) for field, name in names.items()})
    claim_dataset(benchmark.root, benchmark.catalogue)
    make_object_tables(benchmark.root, benchmark.recipe("mini"), benchmark.catalogue, 0, lambda _: None)
    return benchmark


def hashes(benchmark: Benchmark, shard: str) -> dict[str, str]:
    """Content hash of every table of a shard."""
    return {schema.name: read_sidecar(benchmark.root.shard_table(shard, schema.name)).content_hash for s in STAGES for schema in s.outputs}


def test_an_appended_object_leaves_every_row_of_the_others(tmp_path: Path) -> None:
    before = benchmark_of(tmp_path / "grown", ("bracket", "wedge"))
    for shard in SHARDS:
        before.run(shard)
    made = {shard: hashes(before, shard) for shard in SHARDS}
    scenes, candidates, executed = (
        read_tables(schema, [before.root.shard_table(shard, schema.name) for shard in SHARDS]).to_pylist()
        for schema in (SCENES, CANDIDATE_PAIRS, EXECUTION_LABELS)
    )
    assert [(row["scene_id"], row["object_id"], row["category"]) for row in scenes] == [
        ("mini-0001", "bracket", "mesh"),
        ("mini-0007", "wedge", "mesh"),
    ]
    assert candidates, "nothing was lifted, so the labels prove nothing"
    assert executed, "nothing was planned, so the labels prove nothing"

    after = benchmark_of(tmp_path / "grown", ("bracket", "wedge", "bottle"))
    assert after.universe("mini")[: len(before.universe("mini"))] == before.universe("mini")
    assert all(report.is_reused for shard in SHARDS for report in after.run(shard)), "what was made is not made again"

    shutil.copytree(after.root.path / "objects", tmp_path / "anew" / "data" / "objects")  # the scenes are what is made anew
    shutil.copy(after.root.dataset_record(), tmp_path / "anew" / "data")
    anew = benchmark_of(tmp_path / "anew", ("bracket", "wedge", "bottle"))
    for shard in SHARDS:
        anew.run(shard)
    assert {shard: hashes(anew, shard) for shard in SHARDS} == made
    assert [a.object_id for a in anew.shard_inputs("mini-002").allocations] == ["bottle"]


def test_a_run_on_a_graph_of_another_catalogue_is_refused(tmp_path: Path) -> None:
    own = Benchmark(catalogue_path=str(EXAMPLES / "own_objects.toml"), data_dir=str(tmp_path))
    with pytest.raises(DatasetError, match=r"its shards are others than those of the graph, which was loaded with PLACEBENCH_CATALOGUE="):
        own.check()


def test_a_dataset_of_one_s_own_has_folders_of_its_own() -> None:
    assert Benchmark().root.path == REPOSITORY / "data"
    assert Benchmark().report_dir("mini") == REPOSITORY / "reports" / "out" / "mini"
    own = Benchmark(catalogue_path="objects/examples/own_objects.toml")
    assert own.root.path == REPOSITORY / "data" / "own" / "own_objects"
    assert own.report_dir("mini") == own.root.path / "reports" / "mini"
    assert Benchmark(recipe_path="my_recipe.toml").root.path == REPOSITORY / "data" / "own" / "my_recipe"
    assert Benchmark(catalogue_path="mine.toml", data_dir="elsewhere").report_dir("full") == REPOSITORY / "elsewhere" / "reports" / "full"


def test_the_example_meshes_are_what_their_script_makes() -> None:
    for name, mesh in make_meshes().items():
        assert (EXAMPLES / name).read_bytes() == mesh.export(file_type="ply", vertex_normal=False), name


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--catalogue", "nowhere.toml"], "CatalogueError: {cwd}/nowhere.toml: cannot be read: No such file or directory"),
        (["--recipe", "nowhere.toml"], "RecipeError: recipe {cwd}/nowhere.toml: No such file or directory, must be a readable file"),
        (
            ["--catalogue", str(EXAMPLES / "own_objects.toml"), "--data", "full"],
            "DatasetError: {cwd}/full: holds a dataset of",
        ),
    ],
    ids=["no catalogue", "no recipe", "another dataset"],
)
def test_bad_arguments_of_build_and_ui_end_in_one_line(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full" / "shards").mkdir(parents=True)
    assert build.main(["mini", *arguments]) == 1
    out, err = capsys.readouterr()
    (line,) = (out + err).splitlines()
    assert line.startswith(words.format(cwd=tmp_path))
    with pytest.raises(SystemExit, match=re.escape(words.format(cwd=tmp_path))):
        ui.main(arguments)
    assert not (tmp_path / "full" / ".dagster_home").exists(), "nothing is left in a folder that was refused"
