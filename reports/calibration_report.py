"""Report of calibration: how far the probabilities of the learned policies can be taken at their word, before and after a temperature.

`python -m reports.calibration_report data/release/pilot --predictions FILE ... [--split object] [--out DIR]`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports.calibration import COLUMNS, N_BINS, TITLES, Fit, Judged, row_of
from reports.command import Asked, report_command
from reports.entries import prediction_frames
from reports.load import candidate_frame, of_scheme, scheme_note
from reports.metrics import MIN_SCENES
from reports.policies import LEARNED, Policy
from reports.ranker_figures import Reliability, reliability_figure
from reports.report import Report, ReportError
from reports.temperature import fitted_temperature, logits_of, scaled
from splits.markdown import table
from tables.vocabulary import Split, SplitScheme

HEADS = ("plan", "exec")
STATES = ("before", "after")


def calibration_report(
    tables: Mapping[str, pa.Table], predictions: pa.Table, *, tier: str, seed: int, scheme: SplitScheme = SplitScheme.SCENE
) -> Report:
    """Report `calibration`, of the test split with temperatures of the validation split.

    Args:
        tables: `candidates`, `splits`, `scenes`, `targets`, `policy_features` of a release.
        predictions: rows of any learned policies.
        tier: printed in the title.
        seed: of the resampling.
        scheme: by what scenes are dealt to the splits; the one that the policies were trained under.

    Raises:
        ReportError: predictions of no learned policy.
    """
    frame, scores = candidate_frame(tables, seed, scheme), frame_of(predictions)
    temperatures: list[list[object]] = []
    rows: list[list[object]] = []
    bins: list[dict[str, object]] = []
    metrics: dict[str, float] = {}
    figure: dict[str, dict[str, list[Reliability]]] = {}
    for policy in LEARNED:
        trainings = prediction_frames(frame, scores, policy.variant)
        if not trainings:
            continue
        fitted = {own: fitted_temperatures(of_split(trained, Split.VALIDATION)) for own, trained in trainings.items()}
        for own, by_head in fitted.items():
            temperatures.append([policy.label, own, *(None if t is None else f"{t:.3f}" for t in by_head.values())])
            metrics |= {f"temperature.{policy.name}.{head}_seed_{own}": t for head, t in by_head.items() if t is not None}
        test = {own: of_split(trained, Split.TEST) for own, trained in trainings.items()}
        for name, states in _judged(test, fitted).items():
            row, values = _measured(policy, name, states, seed)
            rows += [row] if row else []
            metrics |= values
            curves = [Reliability(state, *judged.bins()) for state, judged in states.items() if len(judged.happened)]
            figure.setdefault(policy.label, {})[TITLES[name]] = curves
            bins += [
                {"policy": policy.name, "probability": name, "scaling": curve.label, "mean": mean, "rate": rate, "n": int(n)}
                for curve in curves
                for mean, rate, n in zip(curve.mean.tolist(), curve.rate.tolist(), curve.n.tolist(), strict=True)
            ]
    if not figure:
        raise ReportError("predictions: 0 learned policies, must be at least 1")
    header = ["policy", *COLUMNS, "ECE, scaled", "Brier, scaled", "Brier of the rate"]
    blocks = [
        f"# Calibration on tier {tier}{of_scheme(scheme)}, test split",
        *scheme_note(scheme),
        _ABOUT,
        table(header, rows, align="ll" + "r" * 9),
        "![Rate against mean probability](calibration.png)",
        "A dot is a bin of all trainings together, its size the share of candidates in it. The diagonal is a probability that means what it"
        " says.",
        "## Temperatures",
        "Fitted on the validation split by the negative log likelihood, one for each head and training. Above 1 a head was too sure of"
        " itself, below 1 not sure enough.",
        table(["policy", "training", "a plan exists", "success, given a plan"], temperatures),
    ]
    png = reliability_figure(figure, f"Reliability on test, {tier}{of_scheme(scheme)}".replace("`", ""))
    return Report("calibration", "\n\n".join(blocks) + "\n", {"calibration": png}, metrics, {"calibration-bins": bins})


_ABOUT = (
    f"Expected calibration error (ECE, over {N_BINS} bins of equal width) and Brier score of every probability that a learned policy gives,"
    " as it is and after temperature scaling: the logits of each head divided by a number that the validation split chose. The probability"
    " of success is the product of both heads, scaled or not. AUROC says how well a probability tells candidates apart; success"
    " given a plan is asked of candidates with a plan. Numbers are means over the trainings; intervals are 95 %, scenes resampled and the"
    f" error of few trainings added (of one training: of this very one), none of ECE and Brier score below {MIN_SCENES} scenes. The ECE of"
    " resampled candidates is biased up: its interval may lie above a small value. The last column is the Brier score of whoever"
    " says the rate of the split for every candidate. Scaling leaves the order by one head as it is; that by the product may change."
)


def of_split(frame: pl.DataFrame, split: Split) -> pl.DataFrame:
    """Candidates of a split, with `logit_plan` and `logit_exec`."""
    own = frame.filter(pl.col("split") == split.value)
    return own.with_columns(pl.Series(f"logit_{head}", logits_of(own[f"log_p_{head}"].to_numpy())) for head in HEADS)


def fitted_temperatures(validation: pl.DataFrame) -> dict[str, float | None]:
    """Temperature of each head: that of plans on all candidates, that of executions on those with a plan."""
    planned = validation.filter("y_plan")
    return {
        "plan": fitted_temperature(validation["logit_plan"].to_numpy(), validation["y_plan"].to_numpy()),
        "exec": fitted_temperature(planned["logit_exec"].to_numpy(), planned["success"].to_numpy()),
    }


def _judged(test: Mapping[int, pl.DataFrame], fitted: Mapping[int, Mapping[str, float | None]]) -> dict[str, dict[str, Judged]]:
    """By probability and state; without the state after where a head has no temperature."""
    first = next(iter(test.values()))
    planned = first["y_plan"].to_numpy()
    states = STATES if all(t is not None for by_head in fitted.values() for t in by_head.values()) else STATES[:1]
    judged: dict[str, dict[str, Judged]] = {name: {} for name in TITLES}
    for state in states:
        by_head = {
            head: np.stack([scaled(own[f"logit_{head}"].to_numpy(), _temperature(fitted[seed][head], state)) for seed, own in test.items()])
            for head in HEADS
        }
        scene_ids = np.array(first["scene_id"].to_list())
        success = first["success"].to_numpy()
        judged["plan"][state] = Judged(by_head["plan"], planned, scene_ids.tolist())
        judged["exec"][state] = Judged(by_head["exec"][:, planned], success[planned], scene_ids[planned].tolist())
        judged["success"][state] = Judged(by_head["plan"] * by_head["exec"], success, scene_ids.tolist())
    return judged


def _temperature(fitted: float | None, state: str) -> float:
    return 1.0 if state == STATES[0] or fitted is None else fitted


def _measured(policy: Policy, name: str, states: Mapping[str, Judged], seed: int) -> tuple[list[object], dict[str, float]]:
    """A row of the table, and the same among metrics; nothing where there are no candidates."""
    own = states[STATES[0]]
    if not len(own.happened):
        return [], {}
    prefix = f"test.{policy.name}.{name}"
    metrics = {f"{prefix}.rate": own.rate, f"{prefix}.brier_of_rate": own.brier_of_rate}
    fits = {state: Fit.of(judged, seed, policy.name) for state, judged in states.items()}
    for state, fit in fits.items():
        metrics |= fit.metrics(f"{prefix}.{state}")
    scaled_cells = [fits[STATES[1]].shown_ece, fits[STATES[1]].shown_brier] if STATES[1] in fits else [None, None]
    return [policy.label, *row_of(name, own, fits[STATES[0]]), *scaled_cells, f"{own.brier_of_rate:.4f}"], metrics


def main(arguments: Sequence[str] | None = None) -> int:
    def make(asked: Asked) -> Report:
        assert asked.predictions is not None
        return calibration_report(asked.tables, asked.predictions, tier=asked.tier, seed=asked.seed, scheme=asked.scheme)

    return report_command("calibration_report", make, arguments, needs=(Split.VALIDATION, Split.TEST), needs_predictions=True)


if __name__ == "__main__":
    sys.exit(main())
