"""Report on the engine of held objects: every test of its validity beside its bound; measured in pipelines/proofs/validity."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipelines.codecs import Row
from pipelines.proofs.validity.changes import FRICTION, Change
from pipelines.proofs.validity.criteria import BESIDE, CRITERIA, Criterion, measured_by
from pipelines.proofs.validity.flips import TELLING_SLIP_MM, flips_of, goes_right_way
from pipelines.proofs.validity.running import StudyResult
from reports.metrics import clopper_pearson
from splits.markdown import count, percent, table

NOT_MEASURED = "not measured"
N_LISTED = 60  # flips that are named
NEAR_MARGIN = 0.05

_DEFINITIONS = (
    "Executions are chosen by hash, as many of each category, within it as many of every stored status as is its share; a label *flips*"
    " where success becomes failure or the reverse, against the same run without a change. Intervals are exact binomial, 95 %.",
    "The *demand ratio* is the largest share of a pad's limit surface (an ellipse in tangential force and torque about the jaw axis) that"
    " the inertial wrench of the planned transport and descend takes. The surface is that of the hold as it was measured after the lift:"
    " pressure of an elastic foundation under the object's faces, its lever about the jaw axis, and the friction that a grip takes by"
    " itself where pads touch opposite ends of an object held askew. No engine is asked. Outcomes and slip are the stored ones.",
    "*Outcome* of the cuboids is the stored success, so that failures of release and landing count against theory, which knows nothing of"
    " them; beside it stands the outcome that theory speaks of, held to the release.",
    "*Lost* is the stored status `dropped_in_transport`, or a slip beyond the bound of the verdict, however it ended. *Faults* are admitted"
    " grasps without a lift and plans without an execution in the"
    " release, and runs of these studies for which the engine warned or gave a state that is not finite. A stage whose engine gives up"
    " publishes nothing, so the first two can be found in a release that was tampered with only.",
)


@dataclass(frozen=True, slots=True)
class ValidityReport:
    """The report as text and as numbers.

    Attributes:
        left_out: studies that were not run, whose numbers are not among these.
        holds: whether every number that these studies measure is there and within its bounds.
    """

    markdown: str
    numbers: Mapping[str, float | None]
    left_out: tuple[str, ...]
    holds: bool

    @property
    def json(self) -> str:
        """The numbers by key, null where one was not measured; of a partial run also which studies are left out."""
        content = {**self.numbers, **({"left_out": list(self.left_out)} if self.left_out else {})}
        return json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n"


def validity_report(
    numbers: Mapping[str, float | None], results: Sequence[StudyResult], origin: Mapping[str, str], left_out: Sequence[str] = ()
) -> ValidityReport:
    """Report `validity`.

    Args:
        numbers: of every criterion of the studies that ran and its count, None where it was not measured.
        results: of these studies, for what went wrong and for the flips.
        origin: what the numbers were made from, shown as it is; `tier` is in the title.
        left_out: names of the studies that were not run.
    """
    names = [result.name for result in results]
    criteria, beside = measured_by(CRITERIA, names), measured_by(BESIDE, names)
    verdicts = {criterion.key: _verdict(criterion, numbers) for criterion in criteria}
    n_hold = sum(verdict == "yes" for verdict in verdicts.values())
    missing = [criterion for criterion in (*criteria, *beside) if numbers[criterion.key] is None]
    failed = [criterion.key for criterion in criteria if verdicts[criterion.key] == "no"]
    blocks = [
        f"# Validity of the held object's engine on tier {origin['tier']}" + (f", only {', '.join(names)}" if left_out else ""),
        *_partial(criteria, left_out),
        f"{n_hold} of {len(criteria)} numbers{' of these studies' if left_out else ''} are within their bounds"
        + (f"; outside: {', '.join(f'`{key}`' for key in failed)}" if failed else "")
        + (f"; {sum(verdict == NOT_MEASURED for verdict in verdicts.values())} {NOT_MEASURED}." if missing else "."),
        _table(criteria, numbers, verdicts),
        *(["## Beside them", _table(beside, numbers, {})] if beside else []),
        *(_not_measured(missing, results) if missing or any(result.problem for result in results) else []),
        *_faults(results),
        *_flips(results),
        "## What the words mean",
        *_DEFINITIONS,
        "## Made from",
        table(["what", "which"], [[name, f"`{value}`"] for name, value in origin.items()], align="ll"),
        table(["study", "rows", "core-s in this run"], [[r.name, count(len(r.rows)), f"{r.core_s:.0f}"] for r in results]),
    ]
    return ValidityReport("\n\n".join(blocks) + "\n", numbers, tuple(left_out), n_hold == len(criteria))


def _partial(criteria: Sequence[Criterion], left_out: Sequence[str]) -> list[str]:
    """What a run of some studies says nothing about."""
    if not left_out:
        return []
    names, untested = ", ".join(f"`{name}`" for name in left_out), ", ".join(f"`{c.key}`" for c in CRITERIA if c not in criteria)
    text = f"> **A partial run.** Left out: {names}. So nothing is said here of {untested or 'what they show beside the bounds'}"
    return [text + "; `solver_faults` counts the runs of these studies only, beside what the release stores."]


def _verdict(criterion: Criterion, numbers: Mapping[str, float | None]) -> str:
    value = numbers[criterion.key]
    return NOT_MEASURED if value is None else "yes" if criterion.holds(value) else "no"


def _table(criteria: Sequence[Criterion], numbers: Mapping[str, float | None], verdicts: Mapping[str, str]) -> str:
    rows = []
    for criterion in criteria:
        n = int(numbers[criterion.count_key] or 0)
        row = [criterion.test, f"`{criterion.key}`", _shown(criterion, numbers[criterion.key], n)]
        rows.append([*row, *([criterion.bound, verdicts[criterion.key]] if verdicts else []), count(n), criterion.meaning])
    header = ["test", "key", "measured", *(["bound", "passes"] if verdicts else []), "n", "what it means"]
    return table(header, rows, align="llr" + ("ll" if verdicts else "") + "rl")


def _shown(criterion: Criterion, value: float | None, n: int) -> str:
    if value is None:
        return NOT_MEASURED
    if criterion.is_share and n:
        k = round(value * n)
        return f"{k}/{n}: {clopper_pearson(k, n)} %"
    return f"{value:.0f}" if (value == round(value) and abs(value) >= 1.0) or value == 0.0 else f"{value:.3g}"


def _not_measured(missing: Sequence[Criterion], results: Sequence[StudyResult]) -> list[str]:
    lines = [f"- study `{result.name}`: {result.problem}" for result in results if result.problem]
    names = ", ".join(f"`{criterion.key}`" for criterion in missing)
    reason = "" if lines else " No study that was run measures them."
    return ["## Not measured", *([f"{names}.{reason}"] if missing else []), *(["\n".join(lines)] if lines else [])]


def _faults(results: Sequence[StudyResult]) -> list[str]:
    faults = [f"- {result.name}: {text}" for result in results for text in result.faults]
    return ["## Faults", "\n".join(faults)] if faults else []


def _flips(results: Sequence[StudyResult]) -> list[str]:
    """Flips by change and cause, and each by name: near the tolerance, or on the ground, a label is a coin's edge."""
    rows: list[Row] = [row for result in results if result.name == "flips" for row in result.rows if "change" in row]
    flipped = flips_of(rows, [change for change in Change if change not in (Change.LEVER_UP, Change.LEVER_DOWN)])
    if not flipped:
        return []
    header = [
        "change",
        "candidate",
        "category",
        "status without",
        "with",
        "margin without",
        "with",
        "slip without [mm]",
        "with",
        "right way",
    ]
    order = [change.value for change in Change]
    flipped = sorted(flipped, key=lambda pair: (order.index(pair[1]["change"]), pair[1]["candidate_id"]))
    listed = [
        [
            *(after[name] for name in ("change", "candidate_id", "category")),
            *(f"`{row['status']}`" for row in (before, after)),
            *(f"{row['margin']:.3f}" for row in (before, after)),
            *(f"{row['slip_mm']:.2f}" for row in (before, after)),
            _way(after),
        ]
        for before, after in flipped[:N_LISTED]
    ]
    left = f", the first {N_LISTED} of {count(len(flipped))}" if len(flipped) > N_LISTED else ""
    text = (
        f"The margin is 0 at the tolerance and 1 on the target. *Near* are flips of labels within {NEAR_MARGIN:g} of the tolerance, *landed"
        f" otherwise* those with the same slip in the hand to {TELLING_SLIP_MM:g} mm: what differs came after the fingers opened."
    )
    blocks = ["## Flips by change", text, _by_change(rows), f"Those under changes that have a bound{left}:"]
    return [*blocks, table(header, listed, align="lllllrrrrl")]


def _way(after: Row) -> str | None:
    if after["change"] not in [change.value for change in FRICTION]:
        return None
    return "yes" if goes_right_way(after) else "**no**"


def _by_change(rows: Sequence[Row]) -> str:
    lines = []
    for change in Change:
        own = [row for row in rows if row["change"] == change.value]
        if not own:
            continue
        flipped = flips_of(rows, (change,))
        up = sum(bool(after["is_success"]) for _, after in flipped)
        near = sum(abs(before["margin"]) < NEAR_MARGIN for before, _ in flipped)
        landed = sum(abs(after["slip_mm"] - before["slip_mm"]) < TELLING_SLIP_MM for before, after in flipped)
        success = percent(sum(row["is_success"] for row in own) / len(own))
        lines.append([change.value, count(len(own)), success, up, len(flipped) - up, near, landed])
    return table(["change", "runs", "success", "flips up", "flips down", "near", "landed otherwise"], lines)
