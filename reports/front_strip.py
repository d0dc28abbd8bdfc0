"""The annotated filmstrip of the README: two executions phase by phase, their verdicts, and how much of each tolerance they used."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure

from pipelines.engines.physics.phases import Phase
from pipelines.pictures.filmstrip import photographs
from pipelines.pictures.recording import Moment, Recording
from reports.figures import FAILURE, GREY, INK, SUCCESS, canvas, png
from reports.report import ReportError
from tables.tolerances import Tolerances
from tables.vocabulary import ExecStatus

_FRAME_PX = (400, 340)
_CROP_PX = (slice(20, 330), slice(40, 390))
_LONGEST = 1.25  # of a bar, in tolerances
# What is shown: the phase, how far through it, and what a reader calls that.
_SHOWN = (
    (Phase.HOLD, 1.0, "lifted"),
    (Phase.TRANSPORT, 0.6, "transport"),
    (Phase.DESCEND, 1.0, "descend"),
    (Phase.OPEN, 1.0, "release"),
    (Phase.SETTLE, 1.0, "at rest"),
)


def strip_figure(recordings: Sequence[Recording], tolerances: Tolerances) -> bytes:
    """PNG: one row an execution.

    Raises:
        ReportError: a candidate without an execution, or one that ended before it let go.
    """
    figure = canvas(11.0, 2.12 * len(recordings), layout=None)
    rows = figure.subfigures(len(recordings), 1, squeeze=False)
    for row, recording in zip(rows[:, 0], recordings, strict=True):
        _row(row, recording, tolerances)
    return png(figure)


def _row(row: SubFigure, recording: Recording, tolerances: Tolerances) -> None:
    moments = [_moment(recording, phase, share) for phase, share, _ in _SHOWN]
    panels = row.subplots(1, len(_SHOWN) + 1, width_ratios=[*(1.0 for _ in _SHOWN), 1.2])
    row.subplots_adjust(left=0.008, right=0.992, bottom=0.03, top=0.79, wspace=0.04)
    status = str(recording.labels["exec_status"])
    colour = SUCCESS if status == ExecStatus.SUCCESS.value else FAILURE
    row.text(0.008, 0.93, status.replace("_", " "), fontsize=12.5, fontweight="bold", color=colour, va="center")
    about = f"{recording.candidate.candidate_id}  tolerance_margin {recording.labels['tolerance_margin']:.2f}"
    row.text(0.992, 0.93, about, fontsize=9, color=GREY, va="center", ha="right", family="monospace")
    frames = photographs(recording, moments, _FRAME_PX)
    for axes, frame, (_, _, name) in zip(panels, frames, _SHOWN, strict=False):
        axes.imshow(frame.picture[_CROP_PX], interpolation="antialiased")
        axes.set_axis_off()
        axes.set_title(name, fontsize=9.5, loc="left", pad=3, color=INK)
        axes.text(1.0, 1.015, f"{frame.time_s:.1f} s", fontsize=8, color=GREY, ha="right", va="bottom", transform=axes.transAxes)
    _margins(panels[-1], recording, tolerances)


def _moment(recording: Recording, phase: Phase, share: float) -> Moment:
    own = [moment for moment in recording.moments if moment.phase is phase]
    if not own or not recording.is_executed:
        found = ", ".join(dict.fromkeys(moment.phase.value for moment in recording.moments))
        raise ReportError(f"{recording.candidate.candidate_id}: has no phase {phase.value}, only {found}")
    return own[round(share * (len(own) - 1))]


def _margins(axes: Axes, recording: Recording, tolerances: Tolerances) -> None:
    """How much of each tolerance was used: a bar whose tick is the tolerance, past it in the colour of failures."""
    labels = recording.labels
    used = (
        ("slip in hand", 1e3 * labels["transport_slip_m"], 1e3 * tolerances.slip_m, " mm"),
        ("turn in hand", np.rad2deg(labels["transport_slip_rad"]), np.rad2deg(tolerances.slip_rad), "°"),
        ("off target", 1e3 * labels["final_position_error_m"], 1e3 * tolerances.position_m, " mm"),
        ("turned at rest", np.rad2deg(labels["final_rotation_error_rad"]), np.rad2deg(tolerances.rotation_rad), "°"),
    )
    axes.set_xlim(-0.1, _LONGEST)
    axes.set_ylim(len(used) - 0.3, -0.55)
    axes.set_axis_off()
    for y, (name, value, limit, unit) in enumerate(used):
        colour = SUCCESS if value <= limit else FAILURE
        axes.barh(y + 0.2, 1.0, height=0.2, color="#e4e4e4")
        axes.barh(y + 0.2, min(value / limit, _LONGEST), height=0.2, color=colour)
        axes.plot([1.0, 1.0], [y + 0.03, y + 0.37], color=INK, linewidth=1.1)
        axes.text(0.0, y, name, fontsize=7.5, color=INK, va="bottom")
        axes.text(_LONGEST, y, f"{value:.1f} of {limit:.3g}{unit}", fontsize=7.5, color=colour, va="bottom", ha="right")
