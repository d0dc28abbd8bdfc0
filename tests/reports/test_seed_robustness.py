from __future__ import annotations

import statistics

import pyarrow as pa
import pytest

from reports.report import ReportError
from reports.seed_robustness import seed_robustness_report
from reports.success_at_k import success_at_k_report
from tables import schemas
from tables.store import table_from_rows
from tables.vocabulary import SplitScheme


def test_mean_and_deviation_are_those_of_the_trainings_judged_one_by_one(
    release_tables: dict[str, pa.Table], predictions: pa.Table
) -> None:
    report = seed_robustness_report(release_tables, predictions, tier="pilot", seed=42)
    alone = [
        success_at_k_report(release_tables, predictions.filter(pa.compute.equal(predictions["seed"], seed)), tier="pilot", seed=42).metrics
        for seed in (42, 43)
    ]
    for split in ("validation", "test"):
        for task in ("joint", "fixed"):
            for k in (1, 3, 5):
                name = f"{split}.{task}.ranker.s{k}"
                own = [metrics[name] for metrics in alone]
                assert [report.metrics[f"{name}_seed_{seed}"] for seed in (42, 43)] == pytest.approx(own)
                assert report.metrics[name] == pytest.approx(statistics.fmean(own))
                assert report.metrics[f"{name}_sd"] == pytest.approx(statistics.stdev(own))
                low, high = (report.metrics[f"{name}{end}"] for end in ("_low", "_high"))
                assert low <= report.metrics[name] <= high + 1e-12
    rows = report.tables["seed_robustness-trainings"]
    assert len(rows) == 2 * 2 * 2
    assert rows[0] == {
        "split": "validation", "task": "joint", "policy": "ranker", "seed": 42,
        **{f"s{k}": pytest.approx(alone[0][f"validation.joint.ranker.s{k}"]) for k in (1, 3, 5)},
    }  # fmt: skip


def test_the_paper_stands_beside_its_own_ranker_and_split_alone(release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    rows = [row | {"variant": "local"} for row in predictions.to_pylist() if row["variant"] == "full" and row["seed"] == 42]
    both = pa.concat_tables([predictions, table_from_rows(schemas.PREDICTIONS, rows)])
    text = seed_robustness_report(release_tables, both, tier="pilot", seed=42).markdown
    for spread in ("85.79 ± 0.64", "81.05 ± 0.41", "85.63 ± 1.08", "97.43 ± 0.16"):
        assert text.count(f"| {spread} |") == 1
    (local, *_) = (line for line in text.splitlines() if line.startswith("| Local ranker | 42 |"))
    assert "±" not in local, "one training has no deviation, and the paper none of ours"
    other = seed_robustness_report(release_tables, predictions, tier="pilot", seed=42, scheme=SplitScheme.OBJECT)
    assert "85.79" not in other.markdown
    assert "paper 51.21" not in other.markdown


def test_predictions_of_no_policy_are_refused(release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    direct = predictions.filter(pa.compute.equal(predictions["variant"], "direct"))
    with pytest.raises(ReportError, match="predictions: 0 learned policies, must be at least 1"):
        seed_robustness_report(release_tables, direct, tier="pilot", seed=42)
