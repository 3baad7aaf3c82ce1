"""The figures of a study's report. Their titles say what is found; nothing is told by colour alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from sumo_hmdp.domain.plan import Status
from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.risk_audit import Verdict
from sumo_hmdp.report.case_road import GREY
from sumo_hmdp.report.lane_panel import COLORS
from sumo_hmdp.report.study_canvas import INK, LINE, PAPER, StudyFigure, cells, look, panels
from sumo_hmdp.report.study_table import each, listed, number, printed
from sumo_hmdp.report.study_tables import DISTRIBUTED
from sumo_hmdp.report.study_verdict import BETTER, COMPARED, WORSE, Finding, higher_is_better, wording

SHOWN = (BETTER, WORSE)
# The colour and the hatch of the bar of each status.
STATUS_LOOKS = {
    Status.OPTIMAL: (COLORS[2], ""),
    Status.INCUMBENT: (COLORS[5], ".."),
    Status.RELAXED: (COLORS[4], "//"),
    Status.FALLBACK: (COLORS[1], "xx"),
    Status.RULE: (LINE, "\\\\"),
}


@dataclass(frozen=True)
class Points:
    """A point with its intervals for each cell: a rate [%] against the mean speed [m/s].

    Attributes:
        frame: cell_label, planner, risk_level, context; x, x_low, x_high; y, y_low, y_high.
        label: of the rate.
        rest: cells that have a speed but no such rate: cell_label, context, y.
    """

    frame: pd.DataFrame
    label: str
    rest: pd.DataFrame


def frontier_figure(name: str, points: Points) -> StudyFigure:
    """Draw risk against efficiency, a point a cell, one panel for each context."""
    best = [cell for _, part in points.frame.groupby("context", sort=False) for cell in _unbeaten(part)]
    title = f"No other cell has both a lower {points.label} and a higher mean speed than {listed(best, 4)}"
    if not points.frame["x"].any():
        title = f"The {points.label} is 0 in every cell; the fastest: {listed(best, 4)}"
    told = "; ".join(
        f"{row.cell_label}: {number(row.x)} % ({number(row.x_low)} to {number(row.x_high)}), {number(row.y, 4)} m/s"
        for row in each(points.frame.head(20))
    )
    alt = f"Points with intervals: {points.label} in per cent against mean speed. {told}."

    def draw() -> Figure:
        contexts = list(dict.fromkeys(points.frame["context"]))
        columns = min(2, len(contexts))
        figure, grid = panels(len(contexts), columns, 2.7, title)
        planners = list(dict.fromkeys([*points.frame["planner"], *points.rest["planner"]]))
        for axes, context in zip(grid, contexts, strict=True):
            _frontier_panel(axes, points, context, planners)
        return figure

    key = (
        "A point a cell with its 95 % intervals; a thin line joins the risk levels of a planner. Up is faster, left is "
        "safer; dashed: a cell that makes no plans."
    )
    return StudyFigure(name, title, key, alt, draw)


def _frontier_panel(axes: Axes, points: Points, context: str, planners: Sequence[str]) -> None:
    mine, rest = (frame[frame["context"] == context] for frame in (points.frame, points.rest))
    for planner, swept in mine[mine["risk_level"].notna()].groupby("planner"):
        path = swept.sort_values("risk_level")
        axes.plot(path["x"], path["y"], color=look(planners.index(str(planner)))[0], lw=0.8, alpha=0.6)
    for row in each(mine):
        color, marker = look(planners.index(row.planner))
        spread = [[row.x - row.x_low], [row.x_high - row.x]], [[row.y - row.y_low], [row.y_high - row.y]]
        spread_y = None if np.isnan(spread[1]).any() else spread[1]
        axes.errorbar(row.x, row.y, xerr=spread[0], yerr=spread_y, color=color, marker=marker, markersize=6, lw=0.9)
    for row in each(rest):
        axes.axhline(row.y, color=look(planners.index(row.planner))[0], lw=1.0, ls=(0, (4, 2)))
    axes.set_xlim(left=min(-0.02 * axes.get_xlim()[1], 0))
    right = axes.get_xlim()[1]
    ends = [(row.x_high, row.y, row.cell_label) for row in each(mine)]
    ends += [(right, row.y, f"{row.cell_label}, no plans") for row in each(rest)]
    _name_points(axes, [(x, y, name.replace(f" ({context})", "")) for x, y, name in ends])
    axes.set_xlabel(f"{points.label} [%]")
    axes.set_ylabel("mean speed [m/s]")
    if context:
        axes.set_title(fill(context, 44), loc="left")


def _name_points(axes: Axes, ends: Sequence[tuple[float, float, str]]) -> None:
    """Name points at the right edge, far enough apart to read, each with a thin line to its point."""
    low, high = axes.get_ylim()
    apart = 0.075 * (high - low)
    below = -np.inf
    for x, y, name in sorted(ends, key=lambda end: end[1]):
        place = below = max(y, below + apart)
        axes.annotate(
            name, (x, y), (1.03, place), textcoords=axes.get_yaxis_transform(), va="center", fontsize=7.5, color=INK,
            arrowprops={"arrowstyle": "-", "linewidth": 0.4, "color": GREY, "shrinkA": 1, "shrinkB": 0},
        )  # fmt: skip


def _unbeaten(part: pd.DataFrame) -> list[str]:
    """Return the cells that no other one beats in one respect without losing in the other, by their estimates."""
    known = part[part["x"].notna() & part["y"].notna()]
    x, y = known["x"].to_numpy(), known["y"].to_numpy()
    beaten = [bool(np.any((x <= a) & (y >= b) & ((x < a) | (y > b)))) for a, b in zip(x, y, strict=True)]
    return [name for name, lost in zip(known["cell_label"], beaten, strict=True) if not lost]


def risk_figure(plans: pd.DataFrame) -> StudyFigure:
    """Draw the violation rate per plan against the risk level that was asked for."""
    words = {verdict: plans.loc[plans["verdict"] == verdict, "cell_label"].tolist() for verdict in Verdict}
    parts = [f"{verdict} for {listed(cells, 4)}" for verdict, cells in words.items() if cells]
    title = f"Risk taken over risk asked: {'; '.join(parts)}"
    told = "; ".join(
        f"{row.cell_label}: asked {number(row.risk_level)}, measured {number(row.violation_rate)} "
        f"({number(row.low_rate)} to {number(row.high_rate)}), {row.verdict} "
        f"in {row.run_count} runs"
        for row in each(plans)
    )

    def draw() -> Figure:
        figure, (axes,) = panels(1, 1, 0.7 + 0.42 * len(plans), title)
        for place, row in enumerate(each(plans)):
            color, marker = look(place % len(COLORS))
            rates = 100 * row.violation_rate, 100 * row.low_rate, 100 * row.high_rate
            axes.plot(rates[1:], [place, place], color=color, lw=1.4)
            axes.plot(rates[0], place, color=color, marker=marker, markersize=6)
            axes.plot([100 * row.risk_level] * 2, [place - 0.36, place + 0.36], color=INK, lw=2.0)
            axes.annotate(
                f"{row.verdict} ({row.run_count} runs)", (1.01, place), xycoords=("axes fraction", "data"), va="center",
                fontsize=7.5, color=INK,
            )  # fmt: skip
        cells(axes, plans["cell_label"].tolist())
        axes.set_xlim(left=0)
        axes.set_xlabel("plans that broke the distance [%], with the 95 % interval; upright bar: the risk asked for")
        return figure

    key = "Upright bars: the risk asked for. A point to their left took less; lines are 95 % intervals."
    return StudyFigure("risk", title, key, f"Violation rate per plan of each cell. {told}.", draw)


def forest_figure(findings: Sequence[Finding]) -> StudyFigure:
    """Draw every difference from the baseline with its interval, one panel a metric."""
    count = {outcome: sum(one.outcome == outcome for one in findings) for outcome in SHOWN}
    shown = f"{count[BETTER]} better, {count[WORSE]} worse"
    title = f"{sum(count.values())} of {len(findings)} differences from the baseline are shown after Holm: {shown}"
    names = list(dict.fromkeys(one.comparison.first for one in findings))

    def draw() -> Figure:
        metrics = [name for name in COMPARED if any(one.comparison.metric == name for one in findings)]
        figure, grid = panels(len(metrics), 2, 0.75 + 0.24 * len(names), title)
        for place, (axes, metric) in enumerate(zip(grid, metrics, strict=True)):
            _forest_panel(axes, [one for one in findings if one.comparison.metric == metric], metric)
            cells(axes, names, named=place % 2 == 0)
        return figure

    alt = "Differences with intervals, filled where shown. " + "; ".join(
        f"{one.comparison.first}, {wording(one.comparison.metric).quantity}: {one.outcome}" for one in findings[:40]
    )
    level = f"{100 * findings[0].comparison.level:.4g}"
    key = (
        f"Cell less baseline, with {level} % intervals, the level with which Holm's correction ended. Diamonds: "
        "better; squares: worse; hollow: no difference shown."
    )
    return StudyFigure("differences", title, key, alt, draw)


def _forest_panel(axes: Axes, findings: Sequence[Finding], metric: str) -> None:
    words = wording(metric)
    scale = 100 if words.unit == "%" else 1
    axes.axvline(0, color=GREY, lw=0.8)
    for place, one in enumerate(findings):
        c = one.comparison
        color = COLORS[0] if one.outcome == BETTER else COLORS[1] if one.outcome == WORSE else GREY
        marker = {BETTER: "D", WORSE: "s"}.get(one.outcome, "o")
        axes.plot([scale * c.low, scale * c.high], [place, place], color=color, lw=1.4)
        face = color if one.outcome in SHOWN else PAPER
        axes.plot(scale * c.difference, place, color=color, marker=marker, markerfacecolor=face, markersize=5)
    unit = f" [{words.unit}]" if words.unit else ""
    direction = "better →" if higher_is_better(metric) else "← better"
    axes.set_title(f"{words.quantity}{unit}  {direction}", loc="left")


def distribution_figure(frame: pd.DataFrame) -> StudyFigure:
    """Draw the quantiles of the main metrics, one panel a metric, one box a cell."""
    speed = frame[(frame["metric"] == "speed_mean_mps") & frame["median"].notna()].sort_values("median", kind="stable")
    title = "No run has ended"
    if len(speed):
        low, high = speed.iloc[0], speed.iloc[-1]
        ends = (
            f"{number(low['median'])} m/s ({low['cell_label']}) to {number(high['median'])} m/s ({high['cell_label']})"
        )
        title = (
            f"Median speeds go from {ends}" if len(speed) > 1 else f"The median speed is {number(low['median'])} m/s"
        )
    names = list(dict.fromkeys(frame["cell_label"]))
    medians = list(zip(speed["cell_label"], speed["median"], strict=True))[:40]

    def draw() -> Figure:
        figure, grid = panels(len(DISTRIBUTED), 2, 0.75 + 0.24 * len(names), title)
        for place, (axes, metric) in enumerate(zip(grid, DISTRIBUTED, strict=True)):
            _boxes(axes, frame[frame["metric"] == metric])
            cells(axes, names, named=place % 2 == 0)
            axes.set_title(f"{METRICS.get(metric).label} [{printed(METRICS.get(metric).unit)}]", loc="left")
        return figure

    key = (
        "Boxes of the quarters, whiskers from 5 to 95 per cent, dots at the extremes, triangles where these lie beyond "
        "the axis; the numbers are in the table below."
    )
    alt = f"Medians of the mean speed: {'; '.join(f'{a} {number(b)} m/s' for a, b in medians)}."
    return StudyFigure("distributions", title, key, alt, draw)


def _boxes(axes: Axes, part: pd.DataFrame) -> None:
    spans = part[["min", "q05", "q25", "median", "q75", "q95", "max"]].to_numpy(dtype=np.float64)
    # Extremes far off would press all boxes into a corner; what lies beyond is a triangle at the edge.
    finite = spans[:, :6][np.isfinite(spans[:, :6])]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    room = 0.06 * (high - low or 1.0)
    axes.set_xlim(low - room, high + 3 * room)
    beyond = spans[:, 6] > high + 2 * room
    for place, (least, q05, q25, middle, q75, q95, most) in enumerate(np.minimum(spans, high + 2 * room)):
        axes.plot([q05, q95], [place, place], color=INK, lw=0.9)
        axes.barh(place, q75 - q25, 0.56, q25, facecolor=COLORS[5], edgecolor=INK, linewidth=0.7, alpha=0.6)
        axes.plot([middle, middle], [place - 0.28, place + 0.28], color=INK, lw=1.8)
        axes.plot(least, place, color=INK, marker="o", markersize=2.2)
        axes.plot(
            most, place, color=INK, marker=">" if beyond[place] else "o", markersize=4.5 if beyond[place] else 2.2
        )
    for place, count in enumerate(part["infinite_count"]):
        if count:
            told = f"{count} inf"
            axes.annotate(
                told, (1.0, place), (-1, 7), xycoords=("axes fraction", "data"), textcoords="offset points",
                ha="right", va="center", fontsize=6.5, color=INK,
            )  # fmt: skip


def decision_figure(frame: pd.DataFrame) -> StudyFigure:
    """Draw decision times against the period, and the shares of the statuses."""
    timed = frame[frame["solve_time_p99_ms"].notna()]
    slowest = timed.sort_values("solve_time_p99_ms", kind="stable").iloc[-1]
    missed = int(frame["deadline_miss_count"].sum())
    title = (
        f"99 % of the decisions of the slowest cell, {slowest['cell_label']}, take at most "
        f"{number(slowest['solve_time_p99_ms'])} ms of the {number(slowest['period_ms'])} ms there are; "
        f"{missed or 'none'} of the study took longer than the period"
    )

    def draw() -> Figure:
        figure, (times, statuses) = panels(2, 2, 1.0 + 0.3 * len(frame), title)
        for place, row in enumerate(each(frame)):
            ends = row.solve_time_median_ms, row.solve_time_p99_ms, row.solve_time_max_ms
            times.plot([ends[0], ends[2]], [place, place], color=COLORS[0], lw=1.0)
            for value, marker in zip(ends, ("o", "D", "x"), strict=True):
                times.plot(value, place, color=COLORS[0], marker=marker, markersize=5)
            times.plot([row.period_ms] * 2, [place - 0.36, place + 0.36], color=INK, lw=2.0)
        times.set_xscale("log")
        times.xaxis.set_major_formatter("{x:g}")
        times.xaxis.set_minor_formatter(NullFormatter())
        times.set_xlabel("decision time [ms]: ○ median, ◇ 99 %, × worst; bar: period")  # noqa: RUF001 - its marker
        cells(times, frame["cell_label"].tolist())
        _stack(statuses, frame)
        cells(statuses, frame["cell_label"].tolist(), named=False)
        return figure

    key = "Left: median, 99 % quantile and worst time of a decision, and the period. Right: how decisions came out."
    told = "; ".join(
        f"{row.cell_label}: median {number(row.solve_time_median_ms)} ms, worst {number(row.solve_time_max_ms)} ms"
        for row in each(frame.head(40))
    )
    return StudyFigure("decisions", title, key, f"Decision times. {told}.", draw)


def _stack(axes: Axes, frame: pd.DataFrame) -> None:
    total = frame["decision_count"].to_numpy(dtype=np.float64)
    left = np.zeros(len(frame))
    for status in Status:
        color, hatch = STATUS_LOOKS[status]
        share = 100 * np.divide(frame[f"{status}_count"], total, out=np.zeros(len(frame)), where=total > 0)
        if share.any():
            bars = axes.barh(range(len(frame)), share, 0.56, left, label=status, facecolor=color, edgecolor=INK)
            for bar in bars:
                bar.set(hatch=hatch, linewidth=0.5)
        left += share
    axes.set_xlim(0, 100)
    axes.set_xlabel("share of decisions [%]")
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=5, frameon=False, handlelength=1.2, columnspacing=0.8)
