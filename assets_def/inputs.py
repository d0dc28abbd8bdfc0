"""What identifies the inputs of the assets above the shards: content hashes of tables and releases, versions of code and engines."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from importlib import metadata

from assets_def.resources import REPOSITORY, Benchmark
from pipelines.stage import Stage
from pipelines.stages import STAGES
from splits.errors import ReleaseError
from splits.manifest import read_manifest
from tables.store import StoreError, read_sidecar


def hash_over_shards(benchmark: Benchmark, tier: str, table: str) -> str:
    """SHA-256 over the content hashes of a table in all shards of a tier; raises StoreError where one is not published."""
    paths = [benchmark.root.shard_table(shard, table) for shard in benchmark.layout.shards_of_tier(tier)]
    return _sha256("\n".join(read_sidecar(path).content_hash for path in paths))


def shard_hashes(benchmark: Benchmark, tier: str, tables: Iterable[str]) -> dict[str, str]:
    """`hash_over_shards` of some tables, for a record."""
    return {f"table.{name}": hash_over_shards(benchmark, tier, name) for name in tables}


def tier_hashes(benchmark: Benchmark, tier: str, tables: Iterable[str]) -> dict[str, str]:
    """Content hashes of some tables of a tier, for a record; raises StoreError where one is not published."""
    return {f"table.{name}": read_sidecar(benchmark.root.tier_table(tier, name)).content_hash for name in tables}


def object_hashes(benchmark: Benchmark, tables: Iterable[str]) -> dict[str, str]:
    """Content hashes of some object tables, for a record; raises StoreError where one is not published."""
    return {f"object.{name}": read_sidecar(benchmark.root.object_table(name)).content_hash for name in tables}


def attempts_hash(benchmark: Benchmark, tier: str) -> dict[str, str]:
    """Content hash of the attempts of a tier, for the record of its release; empty where there are none of today's candidates and recipe.

    They are made from a release, and may be part of it from then on. What they were made from is told by the candidates, because the
    release hash is known only once the release is written.
    """
    try:
        attempts = read_sidecar(benchmark.root.tier_table(tier, "attempts"))
    except StoreError:
        return {}
    today = {**tier_hashes(benchmark, tier, ["candidates"]), "recipe": benchmark.recipe_of_tier(tier).hash_of()}
    return {"table.attempts": attempts.content_hash} if today.items() <= attempts.made_from.items() else {}


def timings_hash(benchmark: Benchmark, tier: str) -> str:
    """SHA-256 over the content hashes of all timings in all shards of a tier; raises StoreError where one is not published."""
    paths = [benchmark.root.timings(shard, stage.name) for shard in benchmark.layout.shards_of_tier(tier) for stage in STAGES]
    return _sha256("\n".join(read_sidecar(path).content_hash for path in paths))


def release_hashes(benchmark: Benchmark, tier: str, *, with_timings: bool = False) -> dict[str, str]:
    """The release hash of a tier, for a record; `timings` are measured, so that what reads them names their content too.

    Raises:
        ReleaseError: there is no release, or none with timings.
    """
    manifest = read_manifest(benchmark.root.release(tier))
    hashes = {"release": manifest.release_hash}
    if with_timings:
        if "timings" not in manifest.tables:
            raise ReleaseError(f"{benchmark.root.release(tier)}: no table timings among {sorted(manifest.tables)}")
        hashes["release.timings"] = manifest.tables["timings"].content_hash
    return hashes


def stage_versions(stages: Iterable[Stage]) -> dict[str, str]:
    """Code versions of some stages and versions of their engines, for the record of what runs them again."""
    stages = tuple(stages)
    engines = sorted({engine for stage in stages for engine in stage.engines})
    return {f"code.{stage.name}": stage.code_version for stage in stages} | {f"engine.{name}": metadata.version(name) for name in engines}


def source_version(*places: str) -> str:
    """Twelve hex digits over the Python files of some folders and files of this checkout: the code version of what is cheap to make.

    What takes hours has a version that somebody sets; a report takes seconds, and nobody remembers to raise a number for a sentence.
    """
    paths = [path for place in places for path in ((REPOSITORY / place).rglob("*.py") if "." not in place else [REPOSITORY / place])]
    return _sha256("\n".join(f"{path.relative_to(REPOSITORY)}\n{path.read_text(encoding='utf-8')}" for path in sorted(paths)))[:12]


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
