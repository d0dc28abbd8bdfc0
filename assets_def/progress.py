"""A progress bar with an estimated end over shards and the stages in them, drawn from what the stage assets tell."""

from __future__ import annotations

import logging
import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from assets_def.stages import PROGRESS
from pipelines.running.shard_runner import Progress as StageProgress
from pipelines.stages import STAGES


class ShardProgress(logging.Handler):
    """Context manager: while it is open, unit messages of stages move the bar."""

    def __init__(self, console: Console, n_shards: int) -> None:
        super().__init__(logging.DEBUG)
        self.seconds_by_stage: dict[str, float] = {}
        # Replaced by the shares of this run after its first shard.
        self._shares = {stage.name: stage.time_share for stage in STAGES}
        self._started: dict[str, float] = {}
        self._n_finished, self._n_shards = 0, n_shards
        self._console, self._start = console, time.perf_counter()
        self._bar = Progress(
            TextColumn("{task.description:<34}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            speed_estimate_period=1200,
            disable=n_shards == 0,
        )
        self._task = self._bar.add_task("shards", total=max(1, n_shards))

    def __enter__(self) -> ShardProgress:
        PROGRESS.addHandler(self)
        PROGRESS.setLevel(logging.DEBUG)
        PROGRESS.propagate = False
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        PROGRESS.removeHandler(self)
        self._bar.stop()

    def emit(self, record: logging.LogRecord) -> None:
        progress: StageProgress = record.progress  # type: ignore[attr-defined]
        now = time.perf_counter()
        first = self._started.setdefault(progress.stage, now)
        if progress.done == progress.total:
            self.seconds_by_stage[progress.stage] = self.seconds_by_stage.get(progress.stage, 0.0) + now - first
        names = [stage.name for stage in STAGES]
        before = sum(self._shares.get(name, 0.0) for name in names[: names.index(progress.stage)])
        share = before + self._shares.get(progress.stage, 0.0) * progress.done / progress.total
        text = f"{progress.shard} {progress.stage} {progress.done}/{progress.total}"
        self._bar.update(self._task, completed=self._n_finished + share, description=text)

    def finish_shard(self) -> None:
        """Learn the shares of the stages; a log, which shows no bar, gets a line a shard."""
        self._n_finished += 1
        if not self._console.is_terminal:
            spent_s = time.perf_counter() - self._start
            left_s = spent_s / self._n_finished * (self._n_shards - self._n_finished)
            self._console.print(f"{self._n_finished} of {self._n_shards} shards in {spent_s:.0f} s, about {left_s:.0f} s left")
        self._started.clear()
        total = sum(self.seconds_by_stage.values())
        if total > 0:
            self._shares = {name: value / total for name, value in self.seconds_by_stage.items()}
        self._bar.update(self._task, completed=self._n_finished)
