"""Workflows of the repository call what exists, with pinned actions and no more rights than they need."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def steps(workflow: Path) -> list[dict[str, Any]]:
    return [step for job in yaml.safe_load(workflow.read_text(encoding="utf-8"))["jobs"].values() for step in job["steps"]]


def test_there_is_one_that_publishes_the_site() -> None:
    assert [path.name for path in WORKFLOWS] == ["site.yml"]


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_every_command_is_a_target_of_the_makefile(workflow: Path) -> None:
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    commands = [step["run"] for step in steps(workflow) if "run" in step]
    called = [re.fullmatch(r"make (\w+)(?: TIER=full)?", command) for command in commands]
    assert len(commands) >= 3
    assert all(call and call.group(1) in targets for call in called), commands


def test_the_site_is_rendered_after_everything_that_it_shows() -> None:
    """Films need tables that the repository leaves out, and the gallery shows films where there are plans."""
    made = [step["run"].split()[1] for step in steps(WORKFLOWS[0]) if "run" in step]
    before = [("points", "films"), ("plans", "films"), ("plans", "reports"), ("reports", "site"), ("figures", "site"), ("films", "site")]
    assert [(first, then) for first, then in before if made.index(first) > made.index(then)] == []


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_every_action_is_pinned_to_a_release(workflow: Path) -> None:
    actions = [step["uses"] for step in steps(workflow) if "uses" in step]
    assert len(actions) >= 3
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@v\d+\.\d+\.\d+", action) for action in actions), actions


def test_only_the_deployment_may_write_and_what_it_uploads_is_what_the_site_writes() -> None:
    workflow = yaml.safe_load(WORKFLOWS[0].read_text(encoding="utf-8"))
    assert workflow["permissions"] == {"contents": "read"}
    assert workflow["jobs"]["deploy"]["permissions"] == {"pages": "write", "id-token": "write"}
    assert "permissions" not in workflow["jobs"]["render"]
    (upload,) = [step for step in steps(WORKFLOWS[0]) if "upload-pages-artifact" in step.get("uses", "")]
    assert upload["with"]["path"] == "reports/out/full/site"
