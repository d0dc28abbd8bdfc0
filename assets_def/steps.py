"""What a build goes through above the shards: a step is one multi-asset, with what it publishes and its gates, both read from disk."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from dagster import AssetCheckResult, AssetsDefinition

from assets_def.products import Product
from assets_def.resources import Benchmark


@dataclass(frozen=True, slots=True)
class Step:
    """One step.

    Attributes:
        name: as a terminal shows it.
        asset: what Dagster materializes.
        products: what it publishes for a partition, with what that would be made from today; raises StoreError where an input is missing.
        checks: the gates of a partition that need nothing but what is on disk.
    """

    name: str
    asset: AssetsDefinition
    products: Callable[[Benchmark, str], Sequence[Product]]
    checks: Callable[[Benchmark, str], Iterable[AssetCheckResult]]

    def is_done(self, benchmark: Benchmark, partition: str) -> bool:
        """Whether there is nothing to make, and every gate is open: a red one is never passed by because its table is up to date."""
        is_current = all(product.is_current() for product in self.products(benchmark, partition))
        return is_current and all(check.passed for check in self.checks(benchmark, partition))
