"""Figures of the reports as PNG bytes; what is drawn is counted and estimated elsewhere.

Colours are those of Okabe and Ito (Color Universal Design, 2008), told apart by readers with any colour vision. What the
paper reports is always an open diamond.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from reports.metrics import Estimate

_BLUES = ("#0072B2", "#56B4E9", "#BFE3F5")
SERIES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#000000", "#999999")
SUCCESS, GREY, INK, PAPER, FAILURE = "#009E73", "#999999", "#222222", "#D55E00", "#D55E00"
_FAILURES = ("#E69F00", "#CC79A7", "#0072B2", "#56B4E9", "#D55E00", "#F0E442", "#000000", "#8c564b", "#999999")


@dataclass(frozen=True, slots=True)
class LadderBar:
    """One policy on one task: its estimates by K, and the percentages that the paper reports by K, where it does."""

    label: str
    estimates: Mapping[int, Estimate | None]
    paper: Mapping[int, float]


def ladder_figure(panels: Mapping[str, Sequence[LadderBar]], title: str) -> bytes:
    """S_K of the policies with intervals, one panel a task, those of the paper beside them."""
    figure = canvas(9.0, 3.4 * len(panels) + 0.5)
    for number, (name, bars) in enumerate(panels.items(), 1):
        axes = figure.add_subplot(len(panels), 1, number)
        ks = sorted({k for bar in bars for k in bar.estimates})
        width = 0.8 / len(ks)
        papers: list[tuple[float, float]] = []
        for step, k in enumerate(ks):
            x = np.arange(len(bars)) + (step - (len(ks) - 1) / 2) * width
            estimates = [bar.estimates.get(k) for bar in bars]
            _bars_with_intervals(axes, x, estimates, width * 0.92, _BLUES[step % len(_BLUES)], f"$S_{k}$")
            papers += [(float(at), bar.paper[k]) for at, bar in zip(x, bars, strict=True) if k in bar.paper]
        if papers:
            axes.plot(*zip(*papers, strict=True), "D", color=PAPER, markerfacecolor="white", markersize=5, zorder=4, label="paper")
        axes.set_xticks(np.arange(len(bars)), [_wrapped(bar.label) for bar in bars])
        axes.set_ylim(0, 105)
        axes.set_ylabel("covered groups [%]")
        axes.set_title(name, loc="left", fontsize=10)
        tidy(axes, grid="y")
        if number == 1:
            handles, labels = axes.get_legend_handles_labels()
            order = sorted(range(len(labels)), key=lambda i: (labels[i] == "paper", i))
            chosen = [handles[i] for i in order], [labels[i] for i in order]
            axes.legend(*chosen, ncols=len(ks) + 1, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    headline(figure, title)
    return png(figure)


def status_figure(counts: Mapping[str, Mapping[str, int]], statuses: Sequence[str], good: str, title: str) -> bytes:
    """Shares of statuses as one stacked bar a row; statuses that never occur are left out.

    Args:
        counts: number of each status by row label, drawn from top to bottom.
        statuses: every status, in the order of the stack.
        good: the status that is no failure.
    """
    shown = [status for status in statuses if any(row.get(status, 0) for row in counts.values())]
    # By place in the list of all statuses, so that a status has the same colour in every tier.
    failures = [status for status in statuses if status != good]
    colours = {status: _FAILURES[i % len(_FAILURES)] for i, status in enumerate(failures)} | {good: SUCCESS}
    figure = canvas(9.0, 1.9 + 0.45 * len(counts))
    axes = figure.add_subplot()
    y = np.arange(len(counts))[::-1]
    totals = np.array([max(1, sum(row.values())) for row in counts.values()])
    left = np.zeros(len(counts))
    for status in shown:
        share = 100.0 * np.array([row.get(status, 0) for row in counts.values()]) / totals
        axes.barh(y, share, left=left, height=0.7, color=colours[status], edgecolor="white", linewidth=0.6, label=status.replace("_", " "))
        for at, start, value in zip(y, left, share, strict=True):
            if value >= 6.0:
                dark = colours[status] in ("#000000", "#0072B2", "#009E73", "#D55E00", "#8c564b")
                axes.text(start + value / 2, at, f"{value:.0f}", ha="center", va="center", fontsize=8, color="white" if dark else INK)
        left += share
    axes.set_yticks(y, [f"{name} ({sum(row.values()):,})" for name, row in counts.items()])
    axes.set_xlim(0, 100)
    axes.set_xlabel("share [%]")
    tidy(axes)
    figure.legend(ncols=4, frameon=False, loc="outside lower center", fontsize=8.5)
    headline(figure, title)
    return png(figure)


def shares_figure(rows: Mapping[str, Estimate | None], title: str, xlabel: str, paper: float | None = None) -> bytes:
    """One proportion a row with its interval and the number it rests on; the overall percentage of the paper as a line."""
    figure = canvas(7.5, 1.3 + 0.36 * len(rows))
    axes = figure.add_subplot()
    y = np.arange(len(rows))[::-1]
    for at, estimate in zip(y, rows.values(), strict=True):
        if estimate is not None:
            value, low, high = 100 * estimate.value, 100 * estimate.low, 100 * estimate.high
            axes.barh(at, value, height=0.62, color=SERIES[4])
            axes.errorbar(value, at, xerr=[[max(0.0, value - low)], [max(0.0, high - value)]], color=INK, capsize=3, linewidth=1)
    axes.set_yticks(y, [f"{name} (n = {e.n:,})" if e else f"{name} (n = 0)" for name, e in rows.items()])
    highest = max((100 * e.high for e in rows.values() if e is not None), default=100.0)
    axes.set_xlim(0, min(102.0, 1.1 * max(highest, paper or 0.0, 5.0)))
    axes.set_xlabel(xlabel)
    if paper is not None:
        axes.axvline(paper, color=PAPER, linestyle="--", linewidth=1.2)
        axes.text(paper, 1.01, "paper, overall", color=PAPER, fontsize=8.5, va="bottom", ha="center", transform=axes.get_xaxis_transform())
    tidy(axes, grid="x")
    headline(figure, title)
    return png(figure)


def counts_figure(counts: Mapping[str, Mapping[str, int]], title: str, ylabel: str) -> bytes:
    """Grouped bars on a log scale: one cluster a row label, one bar a key, with the number on top."""
    figure = canvas(7.5, 3.4)
    axes = figure.add_subplot()
    axes.set_yscale("log")
    keys = list(dict.fromkeys(key for row in counts.values() for key in row))
    width = 0.8 / max(1, len(keys))
    for step, key in enumerate(keys):
        x = np.arange(len(counts)) + (step - (len(keys) - 1) / 2) * width
        values = [row.get(key, 0) for row in counts.values()]
        drawn = axes.bar(x, values, width * 0.92, color=SERIES[step], label=key)
        axes.bar_label(drawn, labels=[f"{value:,}" for value in values], fontsize=8, padding=2)
    axes.set_xticks(np.arange(len(counts)), list(counts))
    axes.set_ylabel(ylabel)
    axes.margins(y=0.15)
    axes.set_ylim(bottom=1.0)
    tidy(axes, grid="y")
    figure.legend(frameon=False, ncols=len(keys), loc="outside lower center", fontsize=8.5)
    headline(figure, title)
    return png(figure)


def funnel_figure(stages: Sequence[tuple[str, int, str]], title: str) -> bytes:
    """What is left after each stage.

    Args:
        stages: (label, number, unit) from first to last; a share is printed against the stage before where the unit is the same.
    """
    figure = canvas(8.0, 0.9 + 0.5 * len(stages))
    axes = figure.add_subplot()
    y = np.arange(len(stages))[::-1]
    units = list(dict.fromkeys(unit for _, _, unit in stages))
    largest = {unit: max(1, max(n for _, n, u in stages if u == unit)) for unit in units}
    for at, (number, (label, n, unit)) in zip(y, enumerate(stages), strict=True):
        width = n / largest[unit]
        axes.barh(at, width, left=-width / 2, height=0.74, color=SERIES[units.index(unit)], alpha=0.85)
        before = stages[number - 1] if number else None
        kept = f", {100 * n / before[1]:.0f} % of the stage before" if before and before[2] == unit and before[1] else ""
        axes.text(0.55, at, f"{n:,} {unit}{kept}", va="center", fontsize=9, color=INK)
        axes.text(-0.55, at, label, va="center", ha="right", fontsize=9, color=INK)
    axes.set_xlim(-0.95, 1.25)
    axes.set_axis_off()
    headline(figure, title)
    return png(figure)


def dots_figure(panels: Mapping[str, Mapping[str, tuple[Sequence[float], float | None]]], title: str, xlabel: str) -> bytes:
    """Single runs as dots and their mean as a bar, one panel a measure, one row a variant, the mean of the paper as a diamond.

    Args:
        panels: by measure and variant, the percentage of every run, and the mean that the paper reports, or None.
    """
    n_rows = max(len(rows) for rows in panels.values())
    figure = canvas(3.2 * len(panels) + 1.8, 1.5 + 0.5 * n_rows)
    shared: Axes | None = None
    for number, (name, rows) in enumerate(panels.items(), 1):
        axes = figure.add_subplot(1, len(panels), number, sharey=shared)
        shared = shared or axes
        y = np.arange(len(rows))[::-1]
        for at, (values, paper) in zip(y, rows.values(), strict=True):
            if len(values):
                axes.barh(at, float(np.mean(values)), height=0.6, color=SERIES[4])
                axes.plot(values, [at] * len(values), "o", color=SERIES[0], markersize=4, zorder=3)
            if paper is not None:
                axes.plot([paper], [at], "D", color=PAPER, markerfacecolor="white", markersize=6, zorder=4)
        axes.set_yticks(y, [_wrapped(label, 22) for label in rows])
        axes.tick_params(labelleft=number == 1)
        axes.set_xlim(0, 105)
        axes.set_xlabel(xlabel)
        axes.set_title(name, loc="left", fontsize=10)
        tidy(axes, grid="x")
    headline(figure, f"{title}   (dots: seeds, bar: mean, ◇ paper)")
    return png(figure)


def _bars_with_intervals(axes: Axes, x: np.ndarray, estimates: Sequence[Estimate | None], width: float, colour: str, label: str) -> None:
    known = [(at, e) for at, e in zip(x, estimates, strict=True) if e is not None]
    values = np.array([100 * e.value for _, e in known])
    errors = np.array([[100 * (e.value - e.low), 100 * (e.high - e.value)] for _, e in known]).reshape(-1, 2).T
    axes.bar([at for at, _ in known], values, width, color=colour, label=label)
    axes.errorbar([at for at, _ in known], values, yerr=np.maximum(errors, 0.0), fmt="none", ecolor=INK, elinewidth=0.9, capsize=2)


def canvas(width_in: float, height_in: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """An empty white figure."""
    figure = Figure(figsize=(width_in, height_in), dpi=130, layout=layout, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def headline(figure: Figure, title: str) -> None:
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")


def tidy(axes: Axes, grid: str = "") -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8.5)
    axes.set_axisbelow(True)
    if grid in ("x", "y"):
        axes.grid(axis="x" if grid == "x" else "y", color="#e3e3e3", linewidth=0.8)


def _wrapped(label: str, width: int = 15) -> str:
    lines = [""]
    for word in label.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) > width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n".join(lines)


def png(figure: Figure) -> bytes:
    """The figure as bytes, equal for equal data."""
    buffer = io.BytesIO()
    # Without the software line equal data give equal bytes.
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()
