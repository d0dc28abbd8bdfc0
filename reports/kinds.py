"""The reports of a release: what each reads, what it also shows where that is there, and how it is made. What one says is in its module."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import pyarrow as pa

from pipelines.recipe import Recipe
from reports.ablation import VARIANTS, ablation_report
from reports.audit import audit_report
from reports.calibration_report import calibration_report
from reports.ceiling import ceiling_report
from reports.costs import Costs
from reports.error_analysis import N_WORST, errors_report
from reports.error_films import Films
from reports.gallery import gallery_report
from reports.generalisation import generalisation_report
from reports.learning_curve import learning_curve_report
from reports.load import Task, check_parts
from reports.planner_calls import planner_calls_report
from reports.planner_costs import planner_costs
from reports.policies import LEARNED, TREES, TREES_POSES
from reports.profile import profile_report
from reports.ranking import MACHINE, timing_frame
from reports.repeatability import repeatability_report
from reports.report import Report
from reports.seed_robustness import seed_robustness_report
from reports.shard_diagnostics import shard_diagnostics_report
from reports.solvability import solvability_report
from reports.sources import Sources, scores_of
from reports.success_at_k import DESIGNATED_SEED, success_at_k_report
from reports.trees_probe import trees_probe_report
from splits.errors import ReleaseError
from splits.release_laws import stage_tables
from tables.schemas import OBJECT_TABLES, TIMINGS
from tables.store import join_tables
from tables.vocabulary import Split, SplitScheme

# Filmstrips an execution status.
N_FILMS = {"mini": 1, "pilot": 3, "full": 3}
# Filmstrips of first choices that fail, a task: of all worst groups of `full`, where one takes 1.2 s of a core.
N_ERROR_FILMS = {"mini": 1, "pilot": 3, "full": N_WORST}

_RANKED = ("candidates", "splits", "scenes", "targets", "policy_features")
_TIMES = ("decision_times", "tree_decision_times")
_LEARNED = (*_RANKED, "predictions")
_VARIANTS = tuple(policy.variant for policy in LEARNED if policy not in (TREES, TREES_POSES))
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
    tables, (recipe, why_not) = sources.tables((*_PICTURED, *sources.there(["plans"]))), _recipe_of_films(sources)
    return gallery_report(tables, recipe, tier=sources.tier, n_films=N_FILMS[sources.tier], why_no_films=why_not)


def _recipe_of_films(sources: Sources) -> tuple[Recipe | None, str]:
    """There are films where there are plans and this code has the recipe that they were made with: a film runs a plan again."""
    if not sources.there(["plans"]):
        return None, "table `plans` is left out of this release; `make plans` makes it again"
    try:
        return sources.recipe(), ""
    except ReleaseError as error:
        return None, str(error)


def _learning_curve(sources: Sources) -> Report:
    return learning_curve_report(sources.tables(_RANKED), sources.table("learning_curve"), tier=sources.tier, seed=sources.seed)


def _errors(sources: Sources) -> Report:
    tables, predictions, (recipe, why_not) = _judged(sources, Split.TEST), sources.scores(), _recipe_of_films(sources)
    lacks = [text for name in _PICTURED if (text := sources.missing(name))]
    if recipe is not None and not lacks:
        films = Films(sources.tables((*_PICTURED, "plans")), recipe, N_ERROR_FILMS[sources.tier])
    else:
        films = Films(why_not="; ".join([why_not] if why_not else lacks))
    assert predictions is not None
    return errors_report(
        tables,
        predictions,
        films,
        tier=sources.tier,
        seed=sources.seed,
        scheme=sources.scheme,
        provenance=sources.release.manifest.provenance,
    )


def _repeatability(sources: Sources) -> Report:
    return repeatability_report(sources.table("attempts"), sources.table("candidates"), tier=sources.tier)


def _audit(sources: Sources) -> Report:
    return audit_report(sources.table("audits"), sources.table("candidates"), tier=sources.tier)


def _success_at_k(sources: Sources) -> Report:
    tables, scores = _judged(sources, Split.VALIDATION, Split.TEST), sources.scores()
    return success_at_k_report(tables, scores, _costs(sources), tier=sources.tier, seed=sources.seed, scheme=sources.scheme)


def _planner_calls(sources: Sources) -> Report:
    """Planning costs come from the table of that name, else from the timings of a whole release."""
    tables, costs = _judged(sources, Split.TEST), _costs(sources)
    if costs.planning is None and sources.there(["timings"]):
        costs = replace(costs, planning=planner_costs(sources.table("timings"), tables["candidates"]))
    elif costs.planning is None:
        lacks = f"{sources.missing('planner_costs')}, and {sources.missing('timings')}"
        costs = replace(costs, why_no_planning=f"{lacks}; `python -m reports.planner_costs` makes the one from the other")
    scores = sources.scores()
    return planner_calls_report(tables, scores, costs, tier=sources.tier, seed=sources.seed, scheme=sources.scheme)


def _costs(sources: Sources) -> Costs:
    """Timings of the release and decision times of networks and trees, as far as they are there; the planning costs beside it."""
    there = sources.there(_TIMES)
    times = join_tables(TIMINGS, [sources.table(name) for name in there]) if there else None
    machines = dict.fromkeys(machine for name in there if (machine := sources.origin(name, MACHINE)))
    costs = Costs(timing_frame(sources.tables(sources.there(["timings"])), times), None, " and ".join(machines))
    if not sources.there(["planner_costs"]):
        return costs
    return replace(costs, planning=sources.table("planner_costs"), planning_machine=sources.origin("planner_costs", MACHINE))


def _of_learned(name: str, make: Callable[..., Report]) -> Kind:
    """A report on the learned policies alone, made of what they predict of validation and test."""

    def made(sources: Sources) -> Report:
        tables, predictions = _judged(sources, Split.VALIDATION, Split.TEST), sources.scores()
        return make(tables, predictions, tier=sources.tier, seed=sources.seed, scheme=sources.scheme)

    return Kind(name, _LEARNED, made, ("tree_predictions",), shown_parts={"predictions": _VARIANTS}, by_split=True)


def _ablation(sources: Sources) -> Report:
    tables, predictions = _judged(sources, Split.VALIDATION), sources.table("predictions")
    return ablation_report(tables, predictions, tier=sources.tier, seed=sources.seed, scheme=sources.scheme)


def _trees_probe(sources: Sources) -> Report:
    tables, predictions = _judged(sources, Split.TRAIN, Split.TEST), sources.table("tree_predictions")
    title = f"Trees on {sources.tier}, train split to test split"
    return trees_probe_report(tables, predictions, split="test", seed=DESIGNATED_SEED, title=title, scheme=sources.scheme)


def _judged(sources: Sources, *needed: Split) -> dict[str, pa.Table]:
    """What a ranking is judged on; raises ReportError where a part of another scheme than the paper's has no scene in a small tier."""
    tables = sources.tables(_RANKED)
    if sources.scheme is not SplitScheme.SCENE:
        check_parts(tables, sources.scheme, needed)
    return tables


def _generalisation(sources: Sources) -> Report:
    predictions = {scheme: found for scheme in SplitScheme if (found := sources.scores(scheme)) is not None}
    return generalisation_report(sources.tables(_RANKED), predictions, tier=sources.tier, seed=sources.seed)


def _ceiling(sources: Sources) -> Report:
    tables, replicates = sources.tables(_RANKED), sources.table("test_replicates")
    return ceiling_report(tables, replicates, sources.scores(), tier=sources.tier, seed=sources.seed)


_OTHER_SCORES = [name for scheme in SplitScheme if scheme is not SplitScheme.SCENE for name in scores_of(scheme)]

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
            ("predictions", "tree_predictions", *_TIMES, "timings"),
            shown_parts={"predictions": ("full",), "decision_times": tuple(Task)},
            by_split=True,
        ),
        Kind(
            "planner_calls",
            _RANKED,
            _planner_calls,
            ("predictions", "tree_predictions", *_TIMES, "planner_costs"),
            shown_parts={"predictions": _VARIANTS, "decision_times": tuple(Task)},
            by_split=True,
        ),
        _of_learned("seed_robustness", seed_robustness_report),
        _of_learned("solvability", solvability_report),
        _of_learned("calibration", calibration_report),
        Kind(
            "errors",
            _LEARNED,
            _errors,
            ("tree_predictions", "plans"),
            shown_parts={"predictions": _VARIANTS},
            by_split=True,
        ),
        Kind("learning_curve", (*_RANKED, "learning_curve"), _learning_curve),
        Kind(
            "ablation",
            (*_RANKED, "predictions"),
            _ablation,
            parts={"predictions": ("full",)},
            shown_parts={"predictions": tuple(VARIANTS)},
            by_split=True,
        ),
        Kind(
            "trees_probe",
            (*_RANKED, "tree_predictions"),
            _trees_probe,
            parts={"tree_predictions": (f"{TREES.variant}.{DESIGNATED_SEED}", f"{TREES_POSES.variant}.{DESIGNATED_SEED}")},
            by_split=True,
        ),
        Kind("generalisation", (*_LEARNED, _OTHER_SCORES[0]), _generalisation, ("tree_predictions", *_OTHER_SCORES[1:])),
        Kind("ceiling", (*_RANKED, "test_replicates"), _ceiling, ("predictions", "tree_predictions")),
    )
}
