"""Figures of the reports on learned rankers as PNG bytes, drawn as figures.py draws; what is drawn is counted and estimated elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

from reports.figures import canvas, headline, png, tidy
from reports.metrics import Estimate

_SERIES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000", "#999999")
_MARKERS = "osv^Dph*"
_INK, _PAPER = "#222222", "#D55E00"


@dataclass(frozen=True, slots=True)
class Curve:
    """A line of points with intervals: `x`, and an estimate at each."""

    label: str
    x: Sequence[float]
    estimates: Sequence[Estimate | None]


@dataclass(frozen=True, slots=True)
class RocCurve:
    """Recall of true and of false units at every threshold, and at the one that was chosen."""

    label: str
    recall_true: Float[np.ndarray, "t"]
    recall_false: Float[np.ndarray, "t"]
    chosen: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class RocPanel:
    """One task; `paper` is (recall of true units, recall of false ones) that the paper reports."""

    curves: Sequence[RocCurve]
    paper: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Reliability:
    """A reliability curve: mean probability, rate and number of the units of each bin that holds any."""

    label: str
    mean: Float[np.ndarray, "b"]
    rate: Float[np.ndarray, "b"]
    n: Float[np.ndarray, "b"]


@dataclass(frozen=True, slots=True)
class Line:
    """A level that does not depend on x."""

    label: str
    value: float
    style: str = field(default="--")


def reliability_figure(rows: Mapping[str, Mapping[str, Sequence[Reliability]]], title: str) -> bytes:
    """Rate against mean probability, a row a policy and a column a probability; the size of a dot is the share of units in its bin."""
    columns = list(next(iter(rows.values())))
    figure = canvas(3.1 * len(columns) + 0.4, 2.9 * len(rows) + 0.9)
    for down, (policy, panels) in enumerate(rows.items()):
        for across, (name, curves) in enumerate(panels.items()):
            axes = figure.add_subplot(len(rows), len(columns), down * len(columns) + across + 1)
            axes.plot([0, 1], [0, 1], color="#bbbbbb", linewidth=1, zorder=1)
            for k, curve in enumerate(curves):
                share = curve.n / max(1.0, float(curve.n.sum()))
                axes.plot(curve.mean, curve.rate, color=_SERIES[k], linewidth=1.2, zorder=2 + k, label=curve.label)
                axes.scatter(curve.mean, curve.rate, s=6 + 170 * share, color=_SERIES[k], alpha=0.75, zorder=2 + k, linewidths=0)
            axes.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), aspect="equal")
            axes.set_title(f"{policy}\n{name}", loc="left", fontsize=9)
            if down == len(rows) - 1:
                axes.set_xlabel("mean probability", fontsize=9)
            if not across:
                axes.set_ylabel("rate", fontsize=9)
            if not down and not across:
                axes.legend(frameon=False, fontsize=8, loc="upper left", markerscale=0.7)
            tidy(axes)
    headline(figure, title)
    return png(figure)


def roc_figure(panels: Mapping[str, RocPanel], title: str) -> bytes:
    """Recall of solvable groups against recall of unsolvable ones, a panel a task; a dot is the threshold that was chosen."""
    figure = canvas(max(5.0, 4.4 * len(panels)), 4.8)
    for number, (name, panel) in enumerate(panels.items(), 1):
        axes = figure.add_subplot(1, len(panels), number)
        axes.plot([0, 100], [0, 100], color="#bbbbbb", linewidth=1)
        for k, curve in enumerate(panel.curves):
            axes.step(
                100 * (1 - curve.recall_false), 100 * curve.recall_true, where="post", color=_SERIES[k], linewidth=1.3, label=curve.label
            )
            if curve.chosen is not None:
                axes.plot([100 * (1 - curve.chosen[1])], [100 * curve.chosen[0]], "o", color=_SERIES[k], markersize=6, zorder=4)
        if panel.paper is not None:
            where = [100 - panel.paper[1]], [panel.paper[0]]
            axes.plot(*where, "D", color=_PAPER, markerfacecolor="white", markersize=6, zorder=5, label="paper")
        axes.set(xlim=(-2, 102), ylim=(-2, 102), aspect="equal")
        axes.set_xlabel("unsolvable groups called solvable [%]", fontsize=9)
        axes.set_ylabel("solvable groups called solvable [%]", fontsize=9)
        axes.set_title(name, loc="left", fontsize=10)
        if panel.curves:
            axes.legend(frameon=False, fontsize=8.5, loc="lower right")
        tidy(axes, grid="y")
    headline(figure, title)
    return png(figure)


def curve_figure(
    panels: Mapping[str, tuple[Sequence[Curve], Sequence[Line]]], title: str, xlabel: str, ylabel: str, *, percent: bool = True
) -> bytes:
    """Curves with intervals over a logarithmic axis, a panel a measure; levels that do not depend on it are broken lines."""
    figure = canvas(4.6 * len(panels), 4.1)
    scale = 100.0 if percent else 1.0
    for number, (name, (curves, lines)) in enumerate(panels.items(), 1):
        axes = figure.add_subplot(1, len(panels), number)
        for k, curve in enumerate(curves):  # side by side, so that no interval hides another
            known = [(x, e) for x, e in zip(curve.x, curve.estimates, strict=True) if e is not None]
            y = np.array([scale * e.value for _, e in known])
            around = np.maximum(np.array([[e.value - e.low, e.high - e.value] for _, e in known]).reshape(-1, 2).T, 0.0)
            x, colour, look = [x * 1.02**k for x, _ in known], _SERIES[k % len(_SERIES)], f"{_MARKERS[k % len(_MARKERS)]}-"
            axes.errorbar(x, y, yerr=scale * around, fmt="none", ecolor=colour, capsize=2.5, elinewidth=0.9)
            axes.plot(x, y, look, color=colour, markersize=5, linewidth=1.4, label=curve.label)
        for k, line in enumerate(lines):
            axes.axhline(scale * line.value, color=_INK, linestyle=(line.style, ":", "-.")[k % 3], linewidth=1, label=line.label)
        _log_ticks(axes, sorted({x for curve in curves for x in curve.x}))
        axes.set_xlabel(xlabel, fontsize=9)
        axes.set_ylabel(ylabel, fontsize=9)
        axes.set_title(name, loc="left", fontsize=10)
        if number == 1:
            axes.legend(frameon=False, fontsize=8.5)
        tidy(axes, grid="y")
    headline(figure, title)
    return png(figure)


def _log_ticks(axes: Axes, x: Sequence[float]) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(list(x)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")


def seconds_figure(panels: Mapping[str, Mapping[str, tuple[float, Estimate | None, float]]], title: str) -> bytes:
    """Mean seconds a group on a logarithmic axis, a row an order and a panel a task.

    Args:
        panels: by task and order, mean decision time, seconds in all with their interval, and those of planning everything.
    """
    labels = list(dict.fromkeys(label for rows in panels.values() for label in rows))
    y = {label: float(len(labels) - 1 - k) for k, label in enumerate(labels)}
    figure = canvas(4.6 * len(panels) + 1.2, 1.7 + 0.36 * len(labels))
    for number, (name, rows) in enumerate(panels.items(), 1):
        axes = figure.add_subplot(1, len(panels), number)
        for label, (decision_s, total, everything_s) in rows.items():
            if total is not None:
                around = [[max(0.0, total.value - total.low)], [max(0.0, total.high - total.value)]]
                axes.errorbar(total.value, y[label], xerr=around, fmt="o", color=_SERIES[0], markersize=5, capsize=2.5, elinewidth=1)
            if decision_s > 0.0:
                axes.plot([decision_s], [y[label]], "|", color=_SERIES[2], markersize=11, markeredgewidth=2)
            axes.axvline(everything_s, color=_SERIES[1], linestyle="--", linewidth=1.2)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_ylim(-0.6, len(labels) - 0.4)
        axes.set_yticks(list(y.values()), list(y))
        axes.tick_params(labelleft=number == 1)
        axes.set_xlabel("seconds a group", fontsize=9)
        axes.set_title(name, loc="left", fontsize=9.5)
        tidy(axes, grid="x")
    headline(figure, f"{title}   (dot: in all, green: decision, broken line: planning everything)")
    return png(figure)
