"""What the Dagster instance of this checkout does with a run that failed: a dead process runs once more, a failing step does not."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import pytest
from dagster import DagsterInstance, DagsterRun, DagsterRunStatus, asset, materialize
from dagster._core.events import RunFailureReason
from dagster._core.execution.retries import auto_reexecution_should_retry_run

YAML = Path(__file__).resolve().parents[2] / ".dagster_home" / "dagster.yaml"


@pytest.fixture(scope="module")
def instance(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DagsterInstance]:
    home = tmp_path_factory.mktemp("dagster_home")
    shutil.copy(YAML, home)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DAGSTER_HOME", str(home))
        with DagsterInstance.get() as instance:
            yield instance


@asset
def failing() -> None:
    raise ValueError("deterministic")


# In a process of its own: handlers of loggers keep the streams that they were made with.
TELLING = """
from dagster import DagsterInstance, asset, materialize

@asset
def telling(context):
    context.log.info("1 of 2 units")

with DagsterInstance.get() as instance:
    assert materialize([telling], instance=instance).success
"""


def _failed_run(instance: DagsterInstance) -> DagsterRun:
    settings = {"loggers": {"console": {"config": {"log_level": "CRITICAL"}}}}
    result = materialize([failing], instance=instance, raise_on_error=False, run_config=settings)
    run = instance.get_run_by_id(result.run_id)
    assert run is not None
    assert run.status is DagsterRunStatus.FAILURE
    return run


def test_the_settings_are_read_as_they_are_meant(instance: DagsterInstance) -> None:
    assert instance.run_retries_enabled
    assert instance.run_retries_max_retries == 1
    assert not instance.run_retries_retry_on_asset_or_op_failure
    assert not instance.telemetry_enabled
    assert not instance.nux_enabled
    assert instance.python_log_level == "INFO"


def test_a_terminal_is_told_what_a_step_says_and_no_more(tmp_path: Path) -> None:
    shutil.copy(YAML, tmp_path)
    environment = {**os.environ, "DAGSTER_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", TELLING], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "1 of 2 units" in done.stderr
    assert "DEBUG" not in done.stderr
    assert "STEP_SUCCESS" not in done.stderr


def test_a_failing_step_is_not_run_again(instance: DagsterInstance) -> None:
    run = _failed_run(instance)
    assert run.tags["dagster/failure_reason"] == RunFailureReason.STEP_FAILURE.value
    assert run.tags.get("dagster/will_retry") == "false"
    assert not auto_reexecution_should_retry_run(instance, run, RunFailureReason.STEP_FAILURE)


@pytest.mark.parametrize("reason", [RunFailureReason.UNEXPECTED_TERMINATION, RunFailureReason.RUN_WORKER_RESTART, RunFailureReason.UNKNOWN])
def test_a_dead_process_is_run_once_more(instance: DagsterInstance, reason: RunFailureReason) -> None:
    run = _failed_run(instance)
    assert auto_reexecution_should_retry_run(instance, run, reason)
    family = {"root_run_id": run.run_id, "parent_run_id": run.run_id}
    tags = {f"dagster/{name}": run_id for name, run_id in family.items()}
    again = DagsterRun(job_name=run.job_name, run_id=str(uuid4()), status=DagsterRunStatus.FAILURE, tags=tags, **family)
    assert not auto_reexecution_should_retry_run(instance, instance.add_run(again), reason)
