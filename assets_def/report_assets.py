"""Reports of a tier, one asset each; what a report says, and how it looks, is in reports/."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from dagster import AssetDep, AssetExecutionContext, AssetsDefinition, DataVersion, MaterializeResult, MetadataValue, asset

from assets_def.inputs import release_hashes, shard_hashes, source_version, tier_hashes
from assets_def.metadata import inline_figure
from assets_def.partitions import shards_to_tiers, tier_partitions
from assets_def.products import FilesProduct, Record
from assets_def.resources import Benchmark
from assets_def.steps import Step
from assets_def.trees_assets import TREE_PREDICTIONS, TREE_TIMES
from reports.kinds import KINDS, N_ERROR_FILMS, N_FILMS
from reports.report import Report
from reports.shard_diagnostics import SHARD_TABLES, shard_diagnostics_report
from reports.sources import Sources
from splits.release_reader import Release
from tables.schemas import ALL_SCHEMAS
from tables.store import read_tables

# Any change of a report's wording, numbers or pictures makes it anew.
REPORT_CODE_VERSION = source_version("reports", "pipelines/pictures", "splits/markdown.py")


@dataclass(frozen=True, slots=True)
class ReportKind:
    """One report: its name, what it reads, and how it is made.

    Attributes:
        tables: tables of the tier that it reads.
        shard_tables: tables that it reads shard by shard; without them it reads the release.
        reads_timings: whether it shows how long anything took.
        parameters: of a tier, where the report depends on more than its tables and the recipe.
    """

    name: str
    description: str
    make: Callable[[Benchmark, str], Report]
    tables: tuple[str, ...] = ()
    shard_tables: tuple[str, ...] = ()
    reads_timings: bool = False
    parameters: Mapping[str, int] = field(default_factory=dict)

    @property
    def asset(self) -> str:
        """Name of the asset; a report that shares its name with a package says that it is a report."""
        return self.name if self.shard_tables else f"{self.name}_report"

    @property
    def deps(self) -> list[AssetDep]:
        """Upstream assets."""
        shards = [AssetDep(name, partition_mapping=shards_to_tiers) for name in self.shard_tables]
        return shards or [AssetDep("release"), *(AssetDep(name) for name in self.tables)]

    def product(self, benchmark: Benchmark, tier: str) -> FilesProduct:
        """The report's files and what they would be made from today."""
        made_from = {
            "code": REPORT_CODE_VERSION,
            "recipe": benchmark.recipe_of_tier(tier).hash_of(),
            "library.matplotlib": metadata.version("matplotlib"),
            **(shard_hashes(benchmark, tier, self.shard_tables) or release_hashes(benchmark, tier, with_timings=self.reads_timings)),
            **tier_hashes(benchmark, tier, self.tables),
            **({"parameter": str(self.parameters[tier])} if self.parameters else {}),
        }
        return FilesProduct(benchmark.report_dir(tier) / f"{self.name}.made_from.json", made_from)

    def write(self, benchmark: Benchmark, tier: str) -> tuple[list[Path], dict[str, Any]]:
        """Make the report and publish its files."""
        directory = benchmark.report_dir(tier)
        report = self.make(benchmark, tier)
        report.write(directory)
        return [directory / name for name in report.files()], {}


def _made(name: str) -> Callable[[Benchmark, str], Report]:
    """A report as `make reports` renders it, from the release and the tables of the tier."""

    def make(benchmark: Benchmark, tier: str) -> Report:
        release, beside = Release.open(benchmark.root.release(tier)), benchmark.root.tier_table(tier, name).parent
        return KINDS[name].make(Sources(release, beside, benchmark.recipe_file))

    return make


def _shard_diagnostics(benchmark: Benchmark, tier: str) -> Report:
    """From the shards, because it is looked at before there is a release."""
    shards = benchmark.layout.shards_of_tier(tier)
    paths = {name: [benchmark.root.shard_table(shard, name) for shard in shards] for name in SHARD_TABLES}
    tables = {name: read_tables(ALL_SCHEMAS[name], paths[name]) for name in SHARD_TABLES}
    return shard_diagnostics_report(tables, tier=tier, layout=benchmark.layout)


_SCORES = ("predictions", TREE_PREDICTIONS)
_TIMES = ("decision_times", TREE_TIMES)
PROFILE = ReportKind(
    "profile", "Counts, statuses, coverage and the ladder of policies that learn nothing.", _made("profile"), reads_timings=True
)
REPORTS = (
    ReportKind(
        "shard_diagnostics",
        "Yields of every shard of a tier side by side, with shards that stand out flagged by a robust z-score.",
        _shard_diagnostics,
        shard_tables=SHARD_TABLES,
    ),
    PROFILE,
    ReportKind("gallery", "Contact sheets: scenes, grasps, filmstrips of every outcome.", _made("gallery"), parameters=N_FILMS),
    ReportKind("repeatability", "How often a label comes out the same again.", _made("repeatability"), ("attempts",)),
    ReportKind("audit", "What the audits of the planning labels found.", _made("audit"), ("audits",)),
    ReportKind(
        "success_at_k",
        "S_K of every policy on both tasks, which of them differ, the paper beside ours.",
        _made("success_at_k"),
        (*_SCORES, *_TIMES),
        reads_timings=True,
    ),
    ReportKind(
        "planner_calls",
        "Planner calls until the first plan of every order, and seconds a group against planning everything.",
        _made("planner_calls"),
        (*_SCORES, *_TIMES),
        reads_timings=True,
    ),
    ReportKind("seed_robustness", "S_K of every training of the learned policies, mean and deviation.", _made("seed_robustness"), _SCORES),
    ReportKind("solvability", "Whether the learned policies know that a group holds no success at all.", _made("solvability"), _SCORES),
    ReportKind(
        "calibration", "Whether predicted probabilities mean what they say, before and after a temperature.", _made("calibration"), _SCORES
    ),
    ReportKind(
        "errors",
        "The groups that the local ranker gets most wrong, with films, and what becomes of first choices that fail.",
        _made("errors"),
        _SCORES,
        parameters=N_ERROR_FILMS,
    ),
    ReportKind("learning_curve", "S1 by the number of scenes that rankers were trained on.", _made("learning_curve"), ("learning_curve",)),
    ReportKind(
        "ceiling",
        "How far S1 can go when labels flip, and what first choices are worth under small uncertainty.",
        _made("ceiling"),
        ("test_replicates", *_SCORES),
    ),
    ReportKind("ablation", "The ranker and three ablations on the validation split.", _made("ablation"), ("predictions",)),
    ReportKind(
        "trees_probe",
        "How far trees on derived geometry rank, beside the policies that learn nothing.",
        _made("trees_probe"),
        (TREE_PREDICTIONS,),
    ),
)


def _report_asset(kind: ReportKind) -> AssetsDefinition:
    @asset(
        name=kind.asset,
        deps=kind.deps,
        description=kind.description,
        group_name="reports",
        code_version=REPORT_CODE_VERSION,
        partitions_def=tier_partitions,
        kinds={"markdown"},
    )
    def report(context: AssetExecutionContext, benchmark: Benchmark) -> MaterializeResult[None]:
        tier = context.partition_key
        record, is_reused = kind.product(benchmark, tier).publish(lambda: kind.write(benchmark, tier))
        markdown = benchmark.report_dir(tier) / f"{kind.name}.md"
        shown = _shown(markdown, record) | {"reused": is_reused}
        return MaterializeResult(metadata=shown, data_version=DataVersion(record.content_hash))

    return report


def _shown(markdown: Path, record: Record) -> dict[str, Any]:
    """A published report as the UI shows it: text, figures, and its metrics as numbers."""
    figures = [markdown.parent / name for name in record.files if name.endswith(".png")]
    metrics: dict[str, float] = json.loads(markdown.with_suffix(".json").read_text(encoding="utf-8"))
    return {
        "path": MetadataValue.path(str(markdown)),
        "report": MetadataValue.md(markdown.read_text(encoding="utf-8")),
        **{name: float(value) for name, value in metrics.items()},
        **{f"figure {path.stem}": inline_figure(path.read_bytes()) for path in figures},
    }


def _step(kind: ReportKind, made: AssetsDefinition) -> Step:
    return Step(f"{kind.name} report", made, lambda benchmark, tier: [kind.product(benchmark, tier)], lambda benchmark, tier: [])


report_assets = [_report_asset(kind) for kind in REPORTS]
report_steps = tuple(_step(kind, made) for kind, made in zip(REPORTS, report_assets, strict=True))
profile_step = report_steps[REPORTS.index(PROFILE)]
