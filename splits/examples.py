"""Candidates that stand for their outcome, chosen by the hash of their ids: the data card names one of each, `make films` shows some."""

from __future__ import annotations

from collections.abc import Sequence

import polars as pl

from splits.markdown import table
from tables.identity import order_key
from tables.vocabulary import ExecStatus, PlanStatus

_LOOK = """Every candidate can be made again from its id alone, as a film, a filmstrip and a trace for Foxglove or Rerun; with `--release`
it must be the stored one in every bit:

```
python -m pipelines.regenerate ID --release DIR{own} --mcap out.mcap --filmstrip out.png --gif out.gif
make films RELEASE=DIR{own_films}      # two of every outcome and category; needs `make points plans RELEASE=DIR` where the release is light
```

One of each outcome, the first by the hash of its id:"""

# Of a catalogue of one's own; DATA is the folder that `make dataset` built it in.
_OF_OWN = {
    "own": " --data DATA --catalogue CATALOGUE [--recipe RECIPE]",
    "own_films": " CATALOGUE=CATALOGUE DATA=DATA [RECIPE=RECIPE]",
}


def chosen_by_outcome(candidates: pl.DataFrame, seed: int, n_each: int, by: Sequence[str] = ()) -> dict[str, list[str]]:
    """Ids by outcome, which is the execution status, or the planning status of what was not executed; fewer where there are no more.

    Args:
        candidates: `candidate_id`, `plan_status`, `exec_status` and the columns of `by`.
        seed: of the hash.
        n_each: of every outcome in every group of `by`.
        by: columns to divide the outcomes by.
    """
    outcome = pl.coalesce(pl.col("exec_status").cast(pl.String), pl.col("plan_status").cast(pl.String))
    groups = candidates.with_columns(outcome.alias("outcome")).group_by("outcome", *by).agg("candidate_id").sort("outcome", *by)
    chosen: dict[str, list[str]] = {}
    for status, names in groups.select("outcome", "candidate_id").iter_rows():
        chosen.setdefault(status, []).extend(sorted(names, key=lambda name: order_key(seed, "sample_films", name))[:n_each])
    return chosen


def examples_section(candidates: pl.DataFrame, seed: int, *, is_own: bool) -> str:
    """How to look at a candidate, and one of every outcome that a release holds; of one's own the commands name its files."""
    look = _LOOK.format(**(_OF_OWN if is_own else dict.fromkeys(_OF_OWN, "")))
    chosen = chosen_by_outcome(candidates, seed, 1)
    in_order = [status.value for status in (*ExecStatus, *PlanStatus) if status.value in chosen]
    rows = [[f"`{status}`", f"`{name}`"] for status in in_order for name in chosen[status]]
    return f"{look}\n\n{table(['outcome', 'candidate'], rows, align='ll')}"
