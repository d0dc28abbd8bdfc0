"""Films of a tier, and its results as static pages; which films, what stands in the pages, and how they look is in reports/."""

import shutil
from importlib import metadata
from pathlib import Path
from typing import Any

from dagster import AssetExecutionContext, DataVersion, MaterializeResult, MetadataValue, asset

from assets_def.inputs import release_hashes, source_version
from assets_def.partitions import tier_partitions
from assets_def.products import FilesProduct
from assets_def.report_assets import REPORTS
from assets_def.resources import Benchmark
from assets_def.steps import Step
from reports.front_page import PICTURES
from reports.sample_films import write_films
from reports.site.__main__ import write_site
from reports.site.films import FILM_KINDS
from reports.site.pages import Site
from reports.sources import Sources
from splits.release_reader import Release
from tables.files import file_sha256

_LOOKS = (f"reports/site/{path.name}" for path in (Path(__file__).parent.parent / "reports" / "site").glob("*.[hcj]*") if path.is_file())
FILMS_CODE_VERSION = source_version("pipelines/pictures", "reports/sample_films.py")
SITE_CODE_VERSION = source_version("reports", "splits/markdown.py", "splits/commands.py", "splits/own.py", *sorted(_LOOKS))


def _product(benchmark: Benchmark, tier: str) -> FilesProduct:
    """The pages, and what they would be made from today: the release, every report that is there, every film that is there."""
    directory = benchmark.report_dir(tier)
    records = {kind.name: kind.product(benchmark, tier).current() for kind in REPORTS}
    films = sorted(path for kind in FILM_KINDS for path in (directory / "films").glob(f"*.{kind}"))
    made_from = {
        "code": SITE_CODE_VERSION,
        "library.jinja2": metadata.version("jinja2"),
        "library.markdown-it-py": metadata.version("markdown-it-py"),
        **release_hashes(benchmark, tier),
        **{f"report.{name}": record.content_hash for name, record in records.items() if record is not None},
        **{f"film.{path.name}": file_sha256(path) for path in films},
        **{f"picture.{path.name}": file_sha256(path) for path in sorted(PICTURES.glob("*.png"))},
    }
    return FilesProduct(directory / "site.made_from.json", made_from)


@asset(
    name="sample_films",
    deps=["release"],
    description="Films and traces of two candidates of every outcome and category, each run again and compared with its label; not part of"
    " `make dataset`.",
    group_name="reports",
    code_version=FILMS_CODE_VERSION,
    partitions_def=tier_partitions,
    kinds={"gif", "mcap"},
)
def sample_films(context: AssetExecutionContext, benchmark: Benchmark) -> MaterializeResult[None]:
    tier = context.partition_key
    directory = benchmark.report_dir(tier)
    made_from = {
        "code": FILMS_CODE_VERSION,
        "recipe": benchmark.recipe_of_tier(tier).hash_of(),
        **release_hashes(benchmark, tier),
    }

    def make() -> tuple[list[Path], dict[str, Any]]:
        release = Release.open(benchmark.root.release(tier))
        sources = Sources(release, benchmark.root.tier_table(tier, "attempts").parent, benchmark.recipe_file)
        shutil.rmtree(directory / "films", ignore_errors=True)  # of another release or other code
        return write_films(sources, directory / "films", log=context.log.info), {}

    record, is_reused = FilesProduct(directory / "sample_films.made_from.json", made_from).publish(make)
    shown: dict[str, Any] = {"path": MetadataValue.path(str(directory / "films")), "films": len(record.files) // 3, "reused": is_reused}
    return MaterializeResult(metadata=shown, data_version=DataVersion(record.content_hash))


@asset(
    name="site",
    deps=["release", "sample_films", *(kind.asset for kind in REPORTS)],
    description="The results as static pages that open from a folder: ladder, reports, objects, scenes, films, card, candidates to filter.",
    group_name="reports",
    code_version=SITE_CODE_VERSION,
    partitions_def=tier_partitions,
    kinds={"html"},
)
def site(context: AssetExecutionContext, benchmark: Benchmark) -> MaterializeResult[None]:
    tier = context.partition_key
    directory = benchmark.report_dir(tier)

    def make() -> tuple[list[Path], dict[str, Any]]:
        pages = Site(Release.open(benchmark.root.release(tier)), directory, directory / "films")
        return write_site(pages, directory / "site"), {}

    record, is_reused = _product(benchmark, tier).publish(make)
    shown: dict[str, Any] = {
        "path": MetadataValue.path(str(directory / "site" / "index.html")),
        "files": len(record.files),
        "reused": is_reused,
    }
    return MaterializeResult(metadata=shown, data_version=DataVersion(record.content_hash))


site_step = Step("site", site, lambda benchmark, tier: [_product(benchmark, tier)], lambda benchmark, tier: [])
