"""S1 object by object is a count by hand, and the interval over objects is that of Student's t."""

from __future__ import annotations

import pyarrow as pa
import pytest
from scipy import stats

from reports.generalisation import generalisation_report
from tables.vocabulary import SplitScheme
from tests.reports.conftest import scores_of
from tests.reports.test_generalisation import OBJECT, SCENE, Tables, all_in_test, as_local, s1


@pytest.fixture(scope="module")
def by_object(release_tables: Tables, predictions: pa.Table) -> tuple[dict[str, float], dict[str, float], str]:
    """S1 of every object by hand, and metrics and text of the report."""
    tables = {**release_tables, "splits": all_in_test(release_tables["splits"])}
    own = as_local(predictions, "full")
    scores = scores_of(own, "local", 42)
    scenes: dict[str, set[str]] = {}
    for row in tables["scenes"].to_pylist():
        scenes.setdefault(row["object_id"], set()).add(row["scene_id"])
    report = generalisation_report(tables, {SCENE: own, OBJECT: own}, tier="full", seed=42)
    return {name: s1(tables, scores, ids) for name, ids in scenes.items()}, dict(report.metrics), report.markdown


def test_every_object_has_its_share(by_object: tuple[dict[str, float], dict[str, float], str]) -> None:
    expected, _, markdown = by_object
    assert len(expected) > 2
    for name, share in expected.items():
        assert fixed_row(markdown, name)[3] == f"{100 * share:.1f}"


def fixed_row(markdown: str, object_id: str) -> list[str]:
    """Cells of an object's row for fixed targets: its name, covered groups, the planner and the local ranker."""
    fixed = markdown[markdown.index("## Fixed target") :]
    return next(line for line in fixed.splitlines() if line.startswith(f"| `{object_id}` |")).split(" | ")


def test_the_mean_over_objects_has_the_interval_of_t(by_object: tuple[dict[str, float], dict[str, float], str]) -> None:
    expected, metrics, markdown = by_object
    n = len(expected)
    assert f"| mean of {n} |" in markdown
    metric = "test.fixed.local_minus_full_planner.s1_over_objects"
    mean, low, high = metrics[metric], metrics[f"{metric}_low"], metrics[f"{metric}_high"]
    # The planner's share as the table prints it, to a tenth of a percent.
    differences = [expected[name] - float(fixed_row(markdown, name)[2]) / 100 for name in expected]
    assert mean == pytest.approx(sum(differences) / n, abs=1e-3)
    assert (low + high) / 2 == pytest.approx(mean)
    theirs = stats.t.interval(0.95, n - 1, loc=mean, scale=stats.sem(differences))
    assert [low, high] == pytest.approx(list(theirs), abs=2e-3)


def test_another_scheme_has_no_objects_of_its_own(release_tables: Tables, predictions: pa.Table) -> None:
    tables = {**release_tables, "splits": all_in_test(release_tables["splits"])}
    own = as_local(predictions, "full")
    report = generalisation_report(tables, {SCENE: own, SplitScheme.LAYOUT: own}, tier="full", seed=42)
    assert not [name for name in report.metrics if "over_objects" in name]
