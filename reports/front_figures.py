"""The ladder and the chain as the README and the first page of the site show them; the filmstrip is front_strip.py's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from pipelines.stages import STAGES
from reports.figures import GREY, INK, PAPER, SERIES, canvas, png, tidy
from reports.kinds import KINDS
from reports.load import Task
from reports.ranking import TASK_TITLE
from reports.standing import Standing
from tables.schemas import OBJECT_TABLES

_UNLEARNED, _LEARNED, _LINE, _DIM = SERIES[0], SERIES[2], "#b8c0c8", "#5a646e"
_RANDOM_LINE = (0, (4, 3))
# What a reader is told of each column of the chain, which are the groups of the asset graph.
_ABOUT = {
    "objects": "mesh, convex parts,\nresting poses, grasps",
    "scenes": "object, 0-2 obstacles,\n8 targets, depth points",
    "grasps": "reachable and free,\nthen lifted in physics",
    "candidates": "each lifted grasp\nwith each target",
    "labels": "a motion is planned,\nthen run in physics",
    "release": "splits, data card,\nmanifest of hashes",
}
_TRUST = (
    "Every draw is seeded by its id, every budget is a count,\n"
    "every table is checked against its law before the next\n"
    "stage reads it: the same bits every time."
)
_LINE_OF_REPORTS = 62  # characters that fit its box
_RANKERS = "five inputs, known before planning:\nPointNet++, local, trees, yours"


def ladder_points_figure(standings: Sequence[Standing], random_means: Mapping[Task, float | None], title: str) -> bytes:
    """PNG: S1 of every policy as a point with its 95 % interval, a panel a task; the paper's figures are open diamonds."""
    figure = canvas(9.2, 1.5 + 0.36 * len(standings))
    axes_of = dict(zip(Task, figure.subplots(1, len(Task), sharey=True), strict=True))
    y = np.arange(len(standings))[::-1]
    for task, axes in axes_of.items():
        for at, standing in zip(y, standings, strict=True):
            _point(axes, at, standing, task)
        mean = random_means[task]
        if mean is not None:
            axes.axvline(mean, color=GREY, linewidth=1, linestyle=_RANDOM_LINE, zorder=1)
        axes.set_xlim(0, 100)
        axes.set_ylim(-0.5, len(standings) - 0.3)
        axes.set_title(TASK_TITLE[task], loc="left", fontsize=10)
        axes.set_xlabel("$S_1$ [% of covered groups]", fontsize=9)
        axes.set_yticks(y, [standing.label for standing in standings])
        tidy(axes, grid="x")
        axes.tick_params(axis="y", length=0, labelsize=9)
    _legend(figure, has_learned=any(standing.policy.is_learned for standing in standings))
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    return png(figure)


def _point(axes: Axes, at: float, standing: Standing, task: Task) -> None:
    s1, colour = standing.s1[task], _LEARNED if standing.policy.is_learned else _UNLEARNED
    axes.plot([s1.low, s1.high], [at, at], color=colour, linewidth=2.4, solid_capstyle="butt", zorder=3)
    axes.plot(s1.value, at, "o", color=colour, markersize=6.5, zorder=4)
    axes.text(s1.value, at + 0.17, f"{s1.value:.1f}", fontsize=8, color=INK, ha="center", va="bottom", zorder=5)
    if s1.paper is not None:
        axes.plot(s1.paper, at, "D", color=PAPER, markerfacecolor="white", markersize=6, markeredgewidth=1.4, zorder=3.5)


def _legend(figure: Figure, *, has_learned: bool) -> None:
    axes = figure.axes[0]
    for colour, label in ((_UNLEARNED, "learns nothing"), (_LEARNED, "learned"))[: 2 if has_learned else 1]:
        axes.plot([], [], color=colour, marker="o", linewidth=2.4, markersize=6, label=f"{label}, with 95 % interval")
    axes.plot([], [], "D", color=PAPER, markerfacecolor="white", markeredgewidth=1.4, label="the paper, on its own data")
    axes.plot([], [], color=GREY, linewidth=1, linestyle=_RANDOM_LINE, label="random, mean of all orders")
    figure.legend(ncols=4, frameon=False, loc="outside lower center", fontsize=8.5)


def chain_figure(numbers: Mapping[str, str]) -> bytes:
    """PNG: the groups of the asset graph from objects to release with the tables that each makes, and what is made from a release.

    Args:
        numbers: how much of it a release holds, by group.
    """
    columns = [("objects", tuple(OBJECT_TABLES)), *_groups(), ("release", ("candidates", "grasps", "splits", "... and the others"))]
    width, height, gap = 11.0, 3.3, 0.26
    figure = canvas(width, height, layout=None)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)
    axes.set_axis_off()
    box = (width - 0.16 - gap * (len(columns) - 1)) / len(columns)
    left = [0.08 + k * (box + gap) for k in range(len(columns))]
    for (name, tables), x in zip(columns, left, strict=True):
        _box(axes, (x, 1.27, box, 1.95), name, numbers.get(name, ""), _ABOUT[name], tables)
    for x in left[1:]:
        _arrow(axes, (x - gap, 2.45), (x - 0.01, 2.45))
    reports = ", ".join(name.replace("_", " ") for name in KINDS if name != "shard_diagnostics")
    _box(axes, (left[4], 0.04, left[5] - left[4] + box, 0.99), "rankers", "", _RANKERS)
    _box(axes, (left[2], 0.04, left[3] - left[2] + box, 0.99), "reports", "", fill(f"{reports}, films, site", _LINE_OF_REPORTS))
    _arrow(axes, (left[5] + box / 2, 1.27), (left[5] + box / 2, 1.04))
    _arrow(axes, (left[4], 0.54), (left[3] + box + 0.01, 0.54))
    axes.text(left[0] + 0.1, 0.92, _TRUST, fontsize=8.2, color=_DIM, va="top", linespacing=1.35)
    return png(figure)


def _groups() -> list[tuple[str, tuple[str, ...]]]:
    """Groups of stages in the order of the chain, with the tables of each."""
    groups: dict[str, list[str]] = {}
    for stage in STAGES:
        groups.setdefault(stage.group, []).extend(schema.name for schema in stage.outputs)
    return [(name, tuple(tables)) for name, tables in groups.items()]


def _box(axes: Axes, place: tuple[float, float, float, float], name: str, number: str, about: str, tables: Sequence[str] = ()) -> None:
    x, y, width, height = place
    axes.add_patch(FancyBboxPatch((x, y), width, height, boxstyle="round,pad=0,rounding_size=0.05", facecolor="#f6f8fa", edgecolor=_LINE))
    axes.text(x + 0.1, y + height - 0.19, name, fontsize=11, fontweight="bold", color=_UNLEARNED, va="center")
    top = y + height - 0.34
    if number:
        axes.text(x + 0.1, top - 0.08, number, fontsize=8.8, fontweight="bold", color=INK, va="center")
        top -= 0.23
    for k, line in enumerate(about.split("\n")):
        axes.text(x + 0.1, top - 0.08 - 0.15 * k, line, fontsize=7.8, color=INK, va="center")
    for k, line in enumerate(tables):
        axes.text(x + 0.1, top - 0.56 - 0.155 * k, line, fontsize=7.4, color=_DIM, va="center", family="monospace")


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    axes.add_patch(FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=11, color=_DIM, linewidth=1.3, shrinkA=0, shrinkB=0))
