"""The reports of a release: what each reads, what it also shows where that is there, and how it is made. What one says is in its module."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import pyarrow as pa

from reports.ablation import VARIANTS, ablation_report
from reports.audit import audit_report
from reports.ceiling import ceiling_report
from reports.gallery import gallery_report
from reports.load import Task, check_parts
from reports.policies import prediction_seeds
from reports.profile import profile_report
from reports.repeatability import repeatability_report
from reports.report import Report, ReportError
from reports.shard_diagnostics import shard_diagnostics_report
from reports.sources import Sources
from reports.success_at_k import DESIGNATED_SEED, success_at_k_report
from reports.trees_probe import trees_probe_report
from splits.release_laws import stage_tables
from tables.schemas import OBJECT_TABLES, PREDICTIONS
from tables.store import join_tables
from tables.vocabulary import Split, SplitScheme

# Filmstrips an execution status.
N_FILMS = {"mini": 1, "pilot": 3, "full": 3}

_RANKED = ("candidates", "splits", "scenes", "targets", "policy_features")
_PICTURED = (*OBJECT_TABLES, "scenes", "obstacles", "targets", "grasps", "candidates")


@dataclass(frozen=True, slots=True)
class Kind:
    """One report.

    Attributes:
        reads: tables without which there is no report.
        shows: tables without which the report says what it lacks.
        parts: of some of `reads`, what they must hold; see `Sources.missing`.
        shown_parts: of some of `shows` or `reads`, what the report shows of them where it is there.
        by_split: whether a split decides it, so that it is another report under another scheme.
    """

    name: str
    reads: tuple[str, ...]
    make: Callable[[Sources], Report]
    shows: tuple[str, ...] = ()
    parts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    shown_parts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    by_split: bool = False

    def lacks(self, sources: Sources) -> list[str]:
        """Why there is no report: what is missing of the tables that it reads, one text a table; raises as `Sources.missing`."""
        return _missing(sources, {name: self.parts.get(name, ()) for name in self.reads})

    def goes_without(self, sources: Sources) -> list[str]:
        """What is missing of the tables that the report also shows; raises as `Sources.missing`."""
        return _missing(sources, {**dict.fromkeys(self.shows, ()), **self.shown_parts})


def _missing(sources: Sources, wanted: Mapping[str, tuple[str, ...]]) -> list[str]:
    return [text for name, parts in wanted.items() if (text := sources.missing(name, parts))]


def _shard_diagnostics(sources: Sources) -> Report:
    joined = sources.tables(("candidates", "grasps"))
    tables = {**sources.tables(("scenes", "targets")), **stage_tables(joined)}
    return shard_diagnostics_report(tables, tier=sources.tier, layout=sources.release.manifest.layout)


def _profile(sources: Sources) -> Report:
    tables = sources.tables((*_RANKED, "grasps", *sources.there(["timings"])))
    return profile_report(tables, tier=sources.tier, seed=sources.seed, scheme=sources.scheme)


def _gallery(sources: Sources) -> Report:
    """With films where there are plans and this code has the recipe that they were made with: a film runs a plan again."""
    tables, recipe, why_not = sources.tables((*_PICTURED, *sources.there(["plans"]))), None, ""
    if "plans" not in tables:
        why_not = "table `plans` is left out of this release; `make plans` makes it again"
    else:
        try:
            recipe = sources.recipe()
        except ReportError as error:
            why_not = str(error)
    return gallery_report(tables, recipe, tier=sources.tier, n_films=N_FILMS[sources.tier], why_no_films=why_not)


def _repeatability(sources: Sources) -> Report:
    return repeatability_report(sources.table("attempts"), sources.table("candidates"), tier=sources.tier)


def _audit(sources: Sources) -> Report:
    return audit_report(sources.table("audits"), sources.table("candidates"), tier=sources.tier)


def _success_at_k(sources: Sources) -> Report:
    tables = _judged(sources, Split.VALIDATION, Split.TEST) | sources.tables(sources.there(["timings"]))
    scores, times = _all_predictions(sources), sources.tables(sources.there(["decision_times"])).get("decision_times")
    return success_at_k_report(tables, scores, times, tier=sources.tier, seed=sources.seed, scheme=sources.scheme)


def _ablation(sources: Sources) -> Report:
    tables, predictions = _judged(sources, Split.VALIDATION), sources.table("predictions")
    return ablation_report(tables, predictions, tier=sources.tier, seed=sources.seed, scheme=sources.scheme)


def _trees_probe(sources: Sources) -> Report:
    tables, predictions = _judged(sources, Split.TRAIN, Split.TEST), sources.table("tree_predictions")
    seeds = prediction_seeds(predictions, "trees")
    seed = DESIGNATED_SEED if DESIGNATED_SEED in seeds else min(seeds, default=DESIGNATED_SEED)
    title = f"Trees on {sources.tier}, train split to test split"
    return trees_probe_report(tables, predictions, split="test", seed=seed, title=title, scheme=sources.scheme)


def _judged(sources: Sources, *needed: Split) -> dict[str, pa.Table]:
    """What a ranking is judged on; raises ReportError where a part of another scheme than the paper's has no scene in a small tier."""
    tables = sources.tables(_RANKED)
    if sources.scheme is not SplitScheme.SCENE:
        check_parts(tables, sources.scheme, needed)
    return tables


def _ceiling(sources: Sources) -> Report:
    tables, replicates = sources.tables(_RANKED), sources.table("test_replicates")
    return ceiling_report(tables, replicates, _all_predictions(sources), tier=sources.tier, seed=sources.seed)


def _all_predictions(sources: Sources) -> pa.Table | None:
    """Those of the networks and those of the trees, as far as they are there."""
    there = sources.tables(sources.there(["predictions", "tree_predictions"]))
    return join_tables(PREDICTIONS, list(there.values())) if there else None


KINDS = {
    kind.name: kind
    for kind in (
        Kind("shard_diagnostics", ("scenes", "targets", "candidates", "grasps"), _shard_diagnostics),
        Kind("profile", (*_RANKED, "grasps"), _profile, ("timings",), by_split=True),
        Kind("gallery", _PICTURED, _gallery, ("plans",)),
        Kind("repeatability", ("candidates", "attempts"), _repeatability),
        Kind("audit", ("candidates", "audits"), _audit),
        Kind(
            "success_at_k",
            _RANKED,
            _success_at_k,
            ("predictions", "tree_predictions", "decision_times", "timings"),
            shown_parts={"predictions": ("full",), "decision_times": tuple(Task)},
            by_split=True,
        ),
        Kind("ablation", (*_RANKED, "predictions"), _ablation, shown_parts={"predictions": tuple(VARIANTS)}, by_split=True),
        Kind(
            "trees_probe",
            (*_RANKED, "tree_predictions"),
            _trees_probe,
            parts={"tree_predictions": ("trees", "trees_poses")},
            by_split=True,
        ),
        Kind("ceiling", (*_RANKED, "test_replicates"), _ceiling, ("predictions", "tree_predictions")),
    )
}
