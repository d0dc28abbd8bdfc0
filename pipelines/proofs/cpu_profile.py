"""Where the core time of a stage goes: its units run under the profiler; see the `timings` tables for what a label costs."""

from __future__ import annotations

import cProfile
import pstats
from pathlib import Path
from typing import Any

from pipelines.running.data_root import DataRoot
from pipelines.running.shard_runner import ShardInputs, units_of_shard
from pipelines.stage import Stage


def largest_costs(stage: Stage, shard: str, root: DataRoot, inputs: ShardInputs, n_units: int, n_costs: int = 3) -> list[tuple[str, float]]:
    """The functions that take the most time themselves, and their shares of the time of the stage.

    Args:
        stage: made for the shard before; nothing is written.
        n_units: units to run, spread over the shard. A profiler makes calls dearer: shares of small Python functions are a little high.
    """
    units = units_of_shard(stage, inputs, root.read_shard(shard, stage.inputs), inputs.allocations)
    profile = cProfile.Profile()
    for unit in units[:: max(1, len(units) // n_units)][:n_units]:
        profile.runcall(stage.run, unit)
    stats: Any = pstats.Stats(profile)
    costs = sorted(((own_s, _name(*key)) for key, (_, _, own_s, _, _) in stats.stats.items()), reverse=True)
    return [(name, own_s / stats.total_tt) for own_s, name in costs[:n_costs]]


def _name(file: str, line: int, function: str) -> str:
    return function if file == "~" else f"{Path(file).stem}.{function}"
