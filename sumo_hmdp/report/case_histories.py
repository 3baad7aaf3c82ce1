"""The paper's figures over time or along the road: actions, speeds and trajectories of Cases 1 and 2."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from matplotlib.typing import LineStyleType
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.report.case_data import CaseRun, Motion
from sumo_hmdp.report.case_road import (
    BLUE,
    HALO,
    ORANGE,
    VERMILLION,
    YELLOW,
    label_of,
    look_of,
    named,
    panels,
    style,
    tidy,
)

# How the paper's instants are marked: its text calls them yellow circles.
INSTANT: dict[str, Any] = {
    "linestyle": "",
    "marker": "o",
    "markersize": 5.5,
    "markerfacecolor": YELLOW,
    "markeredgecolor": "black",
}
# Decisions that are closer have circles that touch [s].
CLOSE = 2.0
# Marks on a curve of speed.
MARKS = 15
# When the curves of the speeds are named [s].
NAMED_AT = 40.0
SOLID: LineStyleType = "-"
DASHED: LineStyleType = (0.0, (3.5, 1.4))


def action_history(run: CaseRun, times: Sequence[float]) -> Figure:
    """Draw lane and mode that the ego intends over time, the actions that change them, and the paper's decisions.

    Args:
        run: a run of Case 1.
        times: when the paper's decisions are taken [s].
    """
    with style():
        figure, (upper, lower) = panels(2, 3.1, sharex=True)
        moments = [decision.time for decision in run.decisions]
        end = float(run.ego.times[-1])
        lanes = [float(decision.lane) for decision in run.decisions]
        modes = [float(decision.mode) for decision in run.decisions]
        for axes, levels in ((upper, lanes), (lower, modes)):
            axes.plot([*moments, end], [*levels, levels[-1]], drawstyle="steps-post", color=BLUE, linewidth=1, zorder=2)
            at = [levels[run.decisions.index(run.decision_at(time))] for time in times]
            axes.plot(times, at, zorder=2.5, **{**INSTANT, "markersize": 6.5})
            _letters(axes, times, at)
            tidy(axes)
            axes.grid(axis="y", color="0.9", linewidth=0.6)
        _actions(upper, moments, lanes, [int(decision.lateral) for decision in run.decisions], up=-1)
        steps = np.diff([float(Mode.CRUISE), *modes]).astype(int).tolist()
        _actions(lower, moments, modes, steps, up=1)
        count = run.lane_count
        upper.set_ylim(count + 0.5, 0.2)
        upper.set_yticks(range(1, count + 1), [f"lane {lane}" for lane in range(1, count + 1)])
        lower.set_ylim(-1.4, 1.8)
        lower.set_yticks([int(mode) for mode in Mode], [mode.label for mode in Mode])
        upper.set_title("lane that the ego intends, and lateral actions", loc="left")
        lower.set_title("mode of the ego, and changes of mode", loc="left")
        lower.set_xlabel("time [s]", labelpad=1)
        lower.set_xlim(-1.0, end + 1.0)
        figure.suptitle("Case 1: what the ego decides", fontsize=8, x=0.01, ha="left")
        legend = [
            Line2D([], [], color=BLUE, label="state"),
            Line2D([], [], linestyle="", marker="^", markersize=5, color=VERMILLION, label="action: left, or mode up"),
            Line2D([], [], label="decision of the paper's snapshot", **INSTANT),
            Line2D([], [], linestyle="", marker="v", markersize=5, color="black", label="action: right, or mode down"),
        ]
        figure.legend(handles=legend, loc="outside lower left", ncols=2, handlelength=1.6, columnspacing=1.0)
        return figure


def _letters(axes: Axes, times: Sequence[float], levels: Sequence[float]) -> None:
    """Write the marks of the snapshots beside the circles, those that are close together to their left and right."""
    for index, (time, level) in enumerate(zip(times, levels, strict=True)):
        close_before = index > 0 and time - times[index - 1] < CLOSE
        close_after = index + 1 < len(times) and times[index + 1] - time < CLOSE
        offset = (-7.5, 0.0) if close_after else (7.5, 0.0) if close_before else (0.0, 9.0)
        axes.annotate(
            chr(ord("a") + index), (time, level), offset, textcoords="offset points", ha="center", va="center",
            fontsize=7, path_effects=HALO, zorder=5,
        )  # fmt: skip


def _actions(axes: Axes, times: Sequence[float], levels: Sequence[float], actions: Sequence[int], up: int) -> None:
    """Mark the decisions that change a level; `up` is the action that goes up on paper."""
    for sign, marker, color in ((up, "^", VERMILLION), (-up, "v", "black")):
        there = [(t, level) for t, level, action in zip(times, levels, actions, strict=True) if action == sign]
        if there:
            axes.plot(*zip(*there, strict=True), linestyle="", marker=marker, markersize=3.6, color=color, zorder=4)


def trajectories(run: CaseRun, mark_every: float) -> Figure:
    """Draw the paths of all vehicles that the paper shows in Case 1, with a mark every so often [s]."""
    with style():
        figure, (axes,) = panels(1, 2.0)
        _lanes(axes, run)
        for motion in (*named(run), run.ego):
            look = look_of(run, motion.vehicle_id)
            at = _marks(motion, mark_every)
            axes.plot(motion.x, motion.y, color=look.color, linestyle=look.line, linewidth=1.2)
            axes.plot(motion.x[at], motion.y[at], linestyle="", marker=look.marker, markersize=4, color=look.color,
                      markeredgecolor="black", markeredgewidth=0.5)  # fmt: skip
            above = motion is run.ego
            for index in at:
                _note_time(axes, motion, int(index), above=above)
        legend = [
            Line2D([], [], color=look.color, linestyle=look.line, marker=look.marker, markersize=4,
                   markeredgecolor="black", markeredgewidth=0.5, label=label_of(motion.vehicle_id))
            for motion in (run.ego, *named(run))
            for look in (look_of(run, motion.vehicle_id),)
        ]  # fmt: skip
        _finish(figure, axes, f"Case 1: everybody's path, a mark every {mark_every:g} s", legend)
        return figure


def ego_trajectories(proposed: CaseRun, rule_based: CaseRun, mark_every: float) -> Figure:
    """Draw the ego's path under both planners: circles for the proposed one, triangles for the rules (Case 2)."""
    with style():
        figure, (axes,) = panels(1, 2.0)
        _lanes(axes, proposed)
        looks = (
            (proposed, "proposed planner", VERMILLION, "o", SOLID),
            (rule_based, "rule-based planner", YELLOW, "^", DASHED),
        )
        legend = []
        for run, name, color, marker, line in looks:
            motion = run.ego
            at = _marks(motion, mark_every)
            shade = color if run is proposed else ORANGE
            axes.plot(motion.x, motion.y, color=shade, linestyle=line, linewidth=1.0, zorder=2)
            mark: dict[str, Any] = {
                "marker": marker,
                "markersize": 4.0,
                "markerfacecolor": color,
                "markeredgecolor": "black",
            }
            axes.plot(motion.x[at], motion.y[at], linestyle="", markeredgewidth=0.5, zorder=3, **mark)
            legend.append(Line2D([], [], color=shade, linestyle=line, label=name, markeredgewidth=0.5, **mark))
            last = len(motion.times) - 1
            for index in (*_marks(motion, 10.0), last):
                if index == last or motion.times[last] - motion.times[index] > 3.0:
                    _note_time(axes, motion, int(index), above=run is rule_based)
        _finish(figure, axes, f"Case 2: the ego's path, a mark every {mark_every:g} s", legend)
        return figure


def speed_profiles(
    proposed: CaseRun, rule_based: CaseRun, times: Sequence[float], rule_times: Sequence[float]
) -> Figure:
    """Draw the speeds of Case 2 under both planners, solid and dashed, with the paper's instants.

    Args:
        proposed: the run under the proposed planner.
        rule_based: the run under the rules.
        times: instants of the paper's snapshots of the first [s].
        rule_times: of the second [s].
    """
    with style():
        figure, (axes,) = panels(1, 2.7)
        legend: list[Line2D] = []
        for motion in (proposed.ego, *named(proposed)):
            look = look_of(proposed, motion.vehicle_id)
            other = rule_based.motions[motion.vehicle_id]
            for line, path, planner in ((SOLID, motion, "proposed"), (DASHED, other, "rules")):
                look_of_curve: dict[str, Any] = {"color": look.color, "linestyle": line, "linewidth": 1.5}
                if motion is not proposed.ego:
                    # The ego's curves carry the instants; those of the others have marks of their own.
                    look_of_curve |= {"linewidth": 1.0, "marker": look.marker, "markersize": 2.6}
                every = max(1, len(path.times) // MARKS)
                axes.plot(path.times, path.speed, zorder=2, markevery=every, **look_of_curve)
                legend.append(Line2D([], [], label=f"{label_of(motion.vehicle_id)}, {planner}", **look_of_curve))
        triangle = INSTANT | {"marker": "^"}
        for run, instants, mark, above in ((proposed, times, INSTANT, True), (rule_based, rule_times, triangle, False)):
            at = [run.ego.index(time) for time in instants]
            axes.plot(run.ego.times[at], run.ego.speed[at], zorder=3, markeredgewidth=0.7, **mark)
            for index, place in enumerate(at):
                axes.annotate(
                    chr(ord("a") + index), (run.ego.times[place], run.ego.speed[place]), (0.0, 7.5 if above else -8.0),
                    textcoords="offset points", ha="center", va="center", fontsize=6.5, path_effects=HALO, zorder=4,
                )  # fmt: skip
        _name_curves(axes, proposed, rule_based, NAMED_AT)
        legend.append(Line2D([], [], label="paper's instants, proposed", **INSTANT))
        legend.append(Line2D([], [], label="paper's instants, rules", **triangle))
        axes.set_xlim(-1.0, float(proposed.ego.times[-1]) + 1.0)
        axes.set_xlabel("time [s]", labelpad=1)
        axes.set_ylabel("speed [m/s]", labelpad=2)
        axes.yaxis.set_major_locator(MaxNLocator(8, integer=True))
        tidy(axes)
        axes.grid(color="0.92", linewidth=0.6)
        figure.suptitle("Case 2: speeds under both planners", fontsize=8, x=0.01, ha="left")
        figure.legend(handles=legend, loc="outside lower left", ncols=2, handlelength=2.4, columnspacing=1.2)
        return figure


def _name_curves(axes: Axes, proposed: CaseRun, rule_based: CaseRun, time: float) -> None:
    """Name the curves where they no longer change, those that lie on each other together."""
    names: list[tuple[float, str]] = []
    for run, planner in ((proposed, ""), (rule_based, ", rules")):
        together: dict[int, list[str]] = {}
        for motion in (run.ego, *named(run)):
            together.setdefault(round(float(motion.speed[motion.index(time)])), []).append(label_of(motion.vehicle_id))
        names += [(speed, f"{' and '.join(labels)}{planner}") for speed, labels in together.items()]
    written: set[float] = set()
    for speed, name in names:
        if speed not in written:
            written.add(speed)
            axes.annotate(
                name, (time, speed), (0.0, 4.5), textcoords="offset points", ha="center", fontsize=6.5,
                path_effects=HALO, zorder=3,
            )  # fmt: skip


def _marks(motion: Motion, every: float) -> NDArray[np.int64]:
    """Return the instants at the multiples of a time."""
    count = int(np.floor(motion.times[-1] / every + 1e-9)) + 1
    return np.array([motion.index(k * every) for k in range(count)], dtype=np.int64)


def _note_time(axes: Axes, motion: Motion, index: int, *, above: bool) -> None:
    axes.annotate(
        f"{motion.times[index]:.0f} s", (float(motion.x[index]), float(motion.y[index])), (0.0, 7.0 if above else -7.5),
        textcoords="offset points", ha="center", va="center", fontsize=6.0, path_effects=HALO, zorder=4,
    )  # fmt: skip


def _lanes(axes: Axes, run: CaseRun) -> None:
    edge = run.lane_count * run.lane_width / 2
    for lane in range(1, run.lane_count):
        axes.axhline(
            run.center_y(lane) - run.lane_width / 2, color="0.75", linewidth=0.8, linestyle=(0, (6, 4)), zorder=0
        )
    for y in (-edge, edge):
        axes.axhline(y, color="0.35", linewidth=0.8, zorder=0)
    axes.set_ylim(-edge - 0.2, edge + 0.2)
    axes.set_yticks([run.center_y(lane) for lane in range(1, run.lane_count + 1)])
    axes.spines[["top", "right", "left", "bottom"]].set_visible(False)


def _finish(figure: Figure, axes: Axes, title: str, legend: list[Line2D]) -> None:
    axes.set_xlabel("position along the road, x [m]", labelpad=1)
    axes.set_ylabel("y [m]", labelpad=2)
    figure.suptitle(title, fontsize=8, x=0.01, ha="left")
    figure.legend(handles=legend, loc="outside lower left", ncols=3, handlelength=3.0, columnspacing=1.2)
