"""What the datasheet and the Croissant metadata both say of how a release was made, what biases it has and what it is for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from splits.markdown import count, percent, share
from splits.provenance import is_own
from splits.summary import Part, Summary

PURPOSE = (
    "Which grasp should a robot choose so that it can also put the object down? The data train and judge rankers that order (grasp, target)"
    " candidates before anything is planned. They reproduce the protocol of a paper whose dataset and code were not published."
)

OWN_PURPOSE = (
    "Which grasp should a robot choose so that it can also put the object down? The data train and judge rankers that order (grasp, target)"
    " candidates before anything is planned, on objects of somebody's own."
)

SENSITIVE = "None. The data describe rigid objects, a robot arm and boxes on a table; no person, place or organisation occurs in them."

SOCIAL_IMPACT = (
    "Better placement makes robots more useful in warehouses, kitchens and care, and replaces some manual work. A ranker that was judged"
    " in simulation only must not be trusted near people before it was tested on its robot."
)

MAINTENANCE = (
    "Versions are major.minor.patch: PATCH re-serialises, MINOR adds rows or columns, MAJOR changes rows or moves them across splits;"
    " CHANGELOG.md of the repository says what each one did. A manifest states the SHA-256 of every file, and the pipeline makes every row"
    " again from its id, so an error can be found, corrected in a new version and proven. Older versions stay where they were deposited."
)

USES = (
    "Training and comparing policies that order the candidates of a scene, or of a scene and a target, by success at K.",
    "Predicting whether a placement motion exists, and whether it ends well when it does.",
    "Studying how the choice of a grasp limits what can be done with the object afterwards.",
)

MISUSES = (
    "Deciding without further tests what a real robot does: no label was confirmed on one.",
    "Comparing rates with those of the paper as if they were of the same data.",
    "Giving a model columns that only planning or physics can know.",
)

MISSING = (
    "Nothing is dropped: every draw, grasp and candidate ends in a status of a closed list. A null means that a question was not asked:"
    " lift columns of a grasp that was not admitted, plan columns of a candidate without a plan, execution columns where nothing could be"
    " executed. No value was imputed."
)

CLEANING = (
    "None after labelling. Points of scene_points are rounded to a grid of 1/8192 m; all other values are stored as they were computed,"
    " and rows are sorted by their key."
)


def made_how(summary: Summary) -> str:
    """From the catalogue to the labels, with counts."""
    return (
        f"Everything is simulated. Objects are solids of a catalogue of {count(summary.n_objects)} products, with convex parts, stable"
        f" poses and a pool of antipodal grasps each. {count(summary.whole.n_scenes)} scenes were drawn, each from the hash of its id: an"
        f" object at rest on a table, {_listed(summary.obstacle_counts)} box obstacles; {count(summary.n_targets)} placement targets in"
        f" all. Of {count(summary.n_pool_grasps)} pool grasps in them {count(summary.n_admitted)} were admitted by geometry and"
        f" {count(summary.n_lifted)} of those lifted the object in physics. Every lifted grasp was paired with every target of its scene:"
        f" {count(summary.whole.n_candidates)} candidates. A motion planner with budgets that are counts looked for a motion of each, and"
        " every motion found was executed in physics."
    )


def labelled_how() -> tuple[str, ...]:
    """The two labels, one sentence or two each."""
    return (
        "y_plan: the planner found a collision-free transport from the measured state after the lift, a straight descent and a straight"
        " retreat. plan_status says why where it did not.",
        "y_pipe: the motion, executed in physics from the measured state, ended as the outcomes section of the data card says a success"
        " does. Null without a plan; exec_status says how it ended.",
    )


def label_checks(summary: Summary) -> str:
    """How labels are checked, and what repeats of them said."""
    checks = (
        "The pipeline repeats its labels in fresh processes, checks motions in a second collision engine, executions in a second physics"
        " engine and rejections by a finer planner; reports beside the release say what came out."
    )
    if not summary.n_repeats + summary.n_attempts:
        return f"{checks} This release holds no repeats of its labels."
    same, flips = f"{count(summary.n_identical)} of {count(summary.n_repeats)}", share(summary.n_flips, summary.n_attempts)
    return (
        f"{checks} In this release {same} repeats in a fresh process are the same in every bit of every label column. {flips} of"
        f" {count(summary.n_attempts)} executions under a changed simulation (half the time step or another hold, friction 5 % up or down,"
        " pad lever 15 % up or down) flip the label."
    )


def biases(summary: Summary, provenance: Mapping[str, str]) -> tuple[str, ...]:
    """Known biases, with counts."""
    of_category = ", ".join(f"{name} {percent(_rate(part))} of {count(part.n_candidates)}" for name, part in summary.by_category.items())
    lifted = share(summary.n_lifted, summary.n_pool_grasps)
    chosen = "chosen by whoever wrote the catalogue" if is_own(provenance) else "after household products of western supermarkets"
    return (
        f"Kinds of objects: {_listed(summary.by_category)} only, {count(summary.n_used_objects)} of {count(summary.n_objects)} catalogue"
        f" objects occur, dimensions and masses {chosen}.",
        f"Success differs by kind: {of_category} candidates. A score over all of them weighs kinds by their candidates.",
        f"Selection by the lift: candidates exist only for grasps that lifted the object, {lifted} of pool grasps. What"
        " a policy would do with grasps that fail to lift is not in the data.",
        "Antipodal grasps of a parallel gripper only, from a pool sampled per object; suction, pushing and two hands are not in the data.",
        "Scenes are drawn so that enough grasps are within reach at the start: objects that can hardly be grasped at all are left out.",
        "Friction is taken from the low end of measured ranges, so grasps slip more often than with clean, dry ware.",
        f"Failures are common: {share(summary.whole.n_planned, summary.whole.n_candidates)} of candidates can be planned,"
        f" {percent(_rate(summary.whole))} of all succeed.",
    )


def _rate(part: Part) -> float | None:
    return part.n_valid / part.n_candidates if part.n_candidates else None


def _listed(items: Iterable[object]) -> str:
    """`a, b or c` of an iterable."""
    names = [str(item) for item in items]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"
