"""What stands above and in the data card for a dataset hub: its YAML front matter, and one line in each library that reads the folder.

`datasets.load_dataset(FOLDER)` and the viewer of the Hugging Face hub read the front matter: one config a table, `candidates` the default
with its three splits. Heavy tables are no config, because the same card stands in light releases, which do not hold them.
"""

from __future__ import annotations

from collections.abc import Mapping

from splits.manifest import BY_SPLIT, LICENCE, files_of_table
from splits.own import title_of
from splits.provenance import is_own
from tables.schemas import HEAVY_TABLES
from tables.vocabulary import Split

DEFAULT_CONFIG = "candidates"
# The split of a table that is not divided: it holds rows of train, validation and test, so none of those may be its name.
UNDIVIDED = "all_splits"
BENCHMARK_TAG = "benchmark"
TAGS = ("robotics", "manipulation", "grasping", "placement", "motion-planning", "physics-simulation", "learning-to-rank", BENCHMARK_TAG)
_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"), (10_000_000, "1M<n<10M"))

READING = """From inside this folder, in any of these. `candidates` is a folder of one file a split (`candidates/split=test/...`), so every
library adds the column `split` to it:

```python
import polars as pl

print(pl.scan_parquet("candidates").group_by("split", "category").agg(pl.len(), pl.col("y_plan", "y_pipe").mean()).collect())
```

```python
import pandas as pd

print(pd.read_parquet("candidates").groupby(["split", "category"], observed=True)[["y_plan", "y_pipe"]].agg("mean"))
```

```python
import duckdb

print(duckdb.sql("SELECT split, category, avg(y_plan::INT), avg(y_pipe::INT) FROM 'candidates/*/*.parquet' GROUP BY ALL ORDER BY ALL"))
```

```python
import pyarrow.dataset as ds

test = ds.dataset("candidates", partitioning="hive").to_table(filter=ds.field("split") == "test")
print(test.group_by("category").aggregate([([], "count_all")]))
```

```python
import os
from datasets import load_dataset

print(load_dataset(os.getcwd())["test"])  # the folder by its path, not "."; candidates here, load_dataset(os.getcwd(), "grasps") and so on
```

Three queries with polars:

```python
import polars as pl

candidates = pl.scan_parquet("candidates").with_columns(pl.col(pl.Categorical).cast(pl.String), success=pl.col("y_pipe").fill_null(False))

# How often can a candidate be planned, and how often is it a success?
print(candidates.group_by("category").agg(pl.len(), pl.col("y_plan", "success").mean()).sort("category").collect())

# Why do planned candidates of the training split fail in execution?
train = candidates.filter((pl.col("split") == "train") & pl.col("y_plan"))
print(train.group_by("exec_status").len().sort("len", descending=True).collect())

# Which targets of the test split can be served by no grasp at all?
test = candidates.filter(pl.col("split") == "test").group_by("scene_id", "target_id").agg(pl.col("success").any())
print(test.filter(~pl.col("success")).sort("scene_id", "target_id").collect())
```

Heavy tables are files like all others where they are there: `pl.scan_parquet("plans.parquet")`, or
`load_dataset("parquet", data_files="plans.parquet")`."""


def front_matter(rows: Mapping[str, int], by_split: Mapping[str, int], facts: Mapping[str, str]) -> str:
    """The YAML block that opens the card. Files without a row are not in it: loaders fail on them.

    Args:
        rows: rows of each table of the release by name.
        by_split: candidates of each split.
        facts: at least `tier` and `version`, and the provenance.
    """
    lines = [
        "---",
        f"license: {'other' if is_own(facts) else LICENCE.lower()}",
        f"pretty_name: {title_of(facts, facts['tier'], facts['version'])}",
        "task_categories:",
        "- robotics",
        "- tabular-classification",
        "tags:",
        *(f"- {tag}" for tag in TAGS if not (is_own(facts) and tag == BENCHMARK_TAG)),
        "size_categories:",
        f"- {_size(rows[DEFAULT_CONFIG])}",
        "configs:",
    ]
    for name in sorted(configs(rows), key=lambda name: (name != DEFAULT_CONFIG, name)):
        splits = [split.value for split in Split] if name in BY_SPLIT else [UNDIVIDED]
        lines += [f"- config_name: {name}", *(["  default: true"] if name == DEFAULT_CONFIG else []), "  data_files:"]
        parts = zip(splits, files_of_table(name), strict=True)
        for split, file in ((split, file) for split, file in parts if split == UNDIVIDED or by_split.get(split)):
            lines += [f"  - split: {split}", f"    path: {file}"]
    return "\n".join([*lines, "---"])


def configs(rows: Mapping[str, int]) -> tuple[str, ...]:
    """The tables that have a config: all with rows that every copy of the release holds."""
    return tuple(name for name, n_rows in rows.items() if n_rows and name not in HEAVY_TABLES)


def _size(n_rows: int) -> str:
    return next((name for bound, name in _SIZES if n_rows < bound), "n>10M")
