"""How sure an execution label is: the section of the data card that says so from margins, slips and repeats under perturbed physics."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import polars as pl

from splits.markdown import MISSING, count, percent, share, table
from tables.vocabulary import ExecStatus, Perturbation

# |tolerance_margin|: 0 is at the tolerance, 1 on the target or twice the tolerance away. Slips in metres.
_MARGIN_EDGES = (0.0, 0.05, 0.1, 0.25, 0.5, 0.75, 1.0, float("inf"))
_SLIP_EDGES_M = (0.0, 1e-4, 1e-3, 5e-3, 2e-2, float("inf"))

# What the card proposes as confident, and measures: a third of the slips that fail.
NEAR_MARGIN, SLIPPING_M, SLIPPING_RAD = 0.25, 1e-3, 0.0175
_STAYED = (pl.col("transport_slip_m") < SLIPPING_M) & (pl.col("transport_slip_rad") < SLIPPING_RAD)
_CONFIDENT = (pl.col("tolerance_margin").abs() >= NEAR_MARGIN) & _STAYED

_KINDS = {
    "time step, hold": (Perturbation.FINE_STEP, Perturbation.HOLD),
    "friction ±5 %": (Perturbation.FRICTION_UP, Perturbation.FRICTION_DOWN),
    "pad lever ±15 %": (Perturbation.PAD_LEVER_UP, Perturbation.PAD_LEVER_DOWN),
}

_ABOUT = """`y_pipe` is what one simulation said. Three columns say how near it is to saying otherwise: `tolerance_margin`, 1 minus the
larger error over its tolerance, whose distance from 0 is the distance from the tolerance; and `transport_slip_m` with
`transport_slip_rad`, how far the object moved and turned in the hand: what slips may fall or hold far from any tolerance, and a success has
a bound on slip too."""

_WITHOUT = """This release holds no `attempts`. The repeatability report that `make dataset` writes beside it says how often labels flip,
by the same columns."""

_FLIPS = """A label *flips* when success becomes failure or the reverse, in `attempts`: executions of the same candidates with half the
time step or another hold, with friction ±5 %, and with the lever of the pads ±15 %. The first change means nothing physically; the others
are as uncertain as the numbers they change."""

_FILTER = f"""Labels that are sure by all of them, in one line of polars:

```python
confident = candidates.filter(~pl.col("y_plan") | ((pl.col("tolerance_margin").abs() >= {NEAR_MARGIN}) \
& (pl.col("transport_slip_m") < {SLIPPING_M}) & (pl.col("transport_slip_rad") < {SLIPPING_RAD})))
```"""


def confidence_section(candidates: pl.DataFrame, attempts: pl.DataFrame | None) -> str:
    """Markdown of the section, without its title.

    Args:
        candidates: table `candidates`.
        attempts: table `attempts`, of any candidates of the release; None where there is none.
    """
    executed = candidates.filter("y_plan")
    repeated = None if attempts is None else _compared(attempts, executed)
    margin, slip = pl.col("tolerance_margin").abs(), pl.col("transport_slip_m")
    return "\n\n".join(
        [
            _ABOUT,
            _WITHOUT if repeated is None else _FLIPS,
            _binned("distance from the tolerance", margin, _MARGIN_EDGES, "", executed, repeated),
            _binned("slip in the hand", slip, _SLIP_EDGES_M, " mm", executed, repeated),
            _FILTER,
            _kept(executed, repeated),
        ]
    )


def count_flips(candidates: pl.DataFrame, attempts: pl.DataFrame) -> tuple[int, int]:
    """Attempts that turn success into failure or back, and all attempts under a changed simulation."""
    repeated = _compared(attempts, candidates.filter("y_plan"))
    return int(repeated["flips"].sum()), repeated.height


def _compared(attempts: pl.DataFrame, executed: pl.DataFrame) -> pl.DataFrame:
    """Perturbed attempts of executed candidates, beside the stored label, and whether they flip it."""
    kinds = pl.DataFrame([(p.value, kind) for kind, some in _KINDS.items() for p in some], schema=["perturbation", "kind"], orient="row")
    stored = executed.select("candidate_id", "tolerance_margin", "transport_slip_m", "transport_slip_rad", "y_pipe")
    frame = attempts.join(kinds, on="perturbation").join(stored, on="candidate_id")
    succeeded = pl.col("exec_status").eq_missing(pl.lit(ExecStatus.SUCCESS.value))
    return frame.with_columns((succeeded != pl.col("y_pipe")).alias("flips"))


def _binned(title: str, value: pl.Expr, edges: Sequence[float], unit: str, executed: pl.DataFrame, repeated: pl.DataFrame | None) -> str:
    scale = 1e3 if unit else 1.0
    rows = []
    for low, high in pairwise(edges):
        is_in = (value >= low) & (value < high)
        own = executed.filter(is_in)
        label = f"from {low * scale:g}{unit}" if high == float("inf") else f"{low * scale:g} to {high * scale:g}{unit}"
        success = percent(float(own["y_pipe"].mean()) if own.height else None)  # type: ignore[arg-type]
        rows.append([label, share(own.height, executed.height), success, *([] if repeated is None else _flips(repeated.filter(is_in)))])
    header = [title, "executed candidates", "success", *([] if repeated is None else ["attempts", *_KINDS, "flips"])]
    return table(header, rows)


def _flips(own: pl.DataFrame) -> list[str]:
    """Attempts, flips of each kind of change, flips of all."""
    some = [own.filter(pl.col("kind") == kind) for kind in _KINDS]
    return [count(own.height), *(_ratio(frame) for frame in (*some, own))]


def _ratio(own: pl.DataFrame) -> str:
    """`3/40 (7.5 %)`; a dash where nothing was tried."""
    n_flips = int(own["flips"].sum())
    return f"{n_flips:,}/{own.height:,} ({percent(n_flips / own.height)})" if own.height else MISSING


def _kept(executed: pl.DataFrame, repeated: pl.DataFrame | None) -> str:
    """What the filter keeps of successes and failures, and how often the kept and the others flip."""
    kept = executed.filter(_CONFIDENT)
    shares = " and ".join(
        f"{percent(kept.filter(of).height / n) if (n := executed.filter(of).height) else 'none'} of {name}"
        for name, of in (("successes", pl.col("y_pipe")), ("failures", ~pl.col("y_pipe")))
    )
    text = (
        f"It keeps {shares} among executed candidates, and every candidate without a plan. Failures that slipped are real, and least sure:"
        " weigh by the filter or report both ways, but do not let it redefine a test split."
    )
    if repeated is None:
        return text
    sure, unsure = (_ratio(repeated.filter(of)) for of in (_CONFIDENT, ~_CONFIDENT))
    return f"{text} Of the attempts on what it keeps {sure} flip, of those on what it drops {unsure}."
