"""Figures for print: what a decision saw, lane by lane over time.

Nothing here touches the global state of matplotlib for longer than a call.
"""

from contextlib import AbstractContextManager
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from sumo_hmdp.decision.decide import Answer
from sumo_hmdp.decision.explain import Explanation
from sumo_hmdp.errors import InputError
from sumo_hmdp.report.figure_data import decision_view, ego_path, lane_view
from sumo_hmdp.report.frontier import frontier_figure
from sumo_hmdp.report.lane_panel import (
    FORBIDDEN_COLOR,
    HATCH_COLOR,
    REACH_COLOR,
    REACH_EDGE,
    SAFE_COLOR,
    draw_bars,
    draw_ego,
    draw_frame,
    draw_stop_line,
    draw_track,
    look_of,
)
from sumo_hmdp.report.short import percent

FORMATS = (".svg", ".png", ".pdf")
# A file tells when it was written unless it is asked not to.
METADATA: dict[str, dict[str, Any]] = {
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
    ".png": {"Software": None},
}
# Letters in a line of the legend.
LEGEND_WIDTH = 22


def figure_path(path: Path, option: str = "--figure") -> Path:
    """Return a path to draw to, if its suffix is one of `FORMATS` and its folder exists.

    Args:
        path: the path.
        option: of the command line that names it, for the messages.

    Raises:
        InputError: if not.
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError(
            [f"{option}: must end in .svg, .png or .pdf, got {str(path)!r}. Give it one of these suffixes"]
        )
    if not path.parent.is_dir():
        raise InputError([f"{option}: must be in a folder that exists, got {str(path)!r}. Make {path.parent} first"])
    return path


def write_decision_figure(path: Path, explanation: Explanation) -> None:
    """Draw a decision to a file; the same explanation gives the same bytes.

    Args:
        path: its suffix chooses the format, one of `FORMATS`.
        explanation: what to draw.

    Raises:
        InputError: if the suffix is another one or the file cannot be written.
    """
    with _style():
        save_figure(decision_figure(explanation), path)


def write_frontier(path: Path, answer: Answer) -> None:
    """Draw the costs and risks of the plans of one decision to a file; the same answer gives the same bytes.

    Args:
        path: its suffix chooses the format, one of `FORMATS`.
        answer: under `joint`.

    Raises:
        InputError: if the suffix is another one, the file cannot be written, or the risk of plans is not computed.
    """
    with _style():
        save_figure(frontier_figure(answer), path, "--frontier")


def save_figure(figure: Figure, path: Path, option: str = "--figure") -> None:
    """Write a figure to a file.

    Raises:
        InputError: if the file cannot be written.
    """
    figure_path(path, option)
    try:
        figure.savefig(path, dpi=200, metadata=METADATA[path.suffix.lower()])
    except OSError as error:
        raise InputError([f"{option}: {path} cannot be written: {error.strerror}. Check its permissions"]) from None


def _style() -> AbstractContextManager[None]:
    """Return the settings of matplotlib for a figure in print, as a context."""
    return mpl.rc_context(
        {
            "font.family": "DejaVu Sans",
            "font.size": 8,
            "axes.titlesize": 8,
            "axes.linewidth": 0.6,
            "hatch.linewidth": 0.5,
            "legend.fontsize": 7.5,
            # A dollar sign in a vehicle's name is one.
            "text.parse_math": False,
            # Element names of an SVG file are drawn from this, not from chance.
            "svg.hashsalt": "sumo-hmdp",
        }
    )


def decision_figure(explanation: Explanation) -> Figure:
    """Draw the lanes over time, one panel a lane, lane 1 (the leftmost) on top.

    Positions are relative to where the ego would be if it cruised, so that what keeps the ego's present speed runs
    level. Distances hold at the end of each step; a bar there stands for that instant.
    """
    view = decision_view(explanation)
    road = explanation.problem.road
    figure = Figure(figsize=(7.0, 0.7 + 1.9 * road.lane_count), layout="constrained")
    panels = figure.subplots(road.lane_count, 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    in_view: set[str] = set()
    for lane, axes in enumerate(panels, start=1):
        content = lane_view(explanation, lane)
        draw_frame(axes, view, _lane_title(explanation, lane))
        draw_bars(axes, view, content)
        for index, track in enumerate(content.tracks):
            if track is not None and draw_track(axes, view, index, track):
                in_view.add(track.vehicle_id)
        draw_stop_line(axes, view, explanation, lane)
        draw_ego(axes, view, explanation, lane)
    panels[-1].set_xlabel("time from now [s]")
    figure.supylabel("position ahead of the cruising ego [m]", fontsize=8)
    figure.suptitle(_title(explanation), fontsize=9, x=0.01, ha="left")
    figure.legend(handles=_legend(explanation, in_view), loc="outside right upper", frameon=False, handlelength=2.4)
    return figure


def _title(explanation: Explanation) -> str:
    answer = explanation.answer
    told = f"{answer.lateral.label}, {answer.mode.label}: {answer.status}"
    if answer.objective is not None:
        told += f", cost {answer.objective:.2f}"
    if answer.violation:
        told += f", {answer.violation:.2f} m missing"
    if explanation.risk is not None:
        told += f", risk {percent(explanation.risk.taken)} of {percent(explanation.risk.level)}"
    if answer.brake is not None:
        told += f", brakes in lane with {answer.brake:.1f} m/s\N{SUPERSCRIPT TWO}"
    return told


def _lane_title(explanation: Explanation, lane: int) -> str:
    settings = explanation.problem.settings
    told = f"lane {lane}"
    if lane == settings.preferences.goal_lane:
        told += ", the goal"
    if lane in settings.forbidden_lanes:
        told += ", not to be chosen"
    return told


def _legend(explanation: Explanation, in_view: set[str]) -> list[Line2D | Patch]:
    def line(label: str, **look: Any) -> Line2D:  # noqa: ANN401 - whatever a line takes
        return Line2D([], [], label=label, **look)

    entries: list[Line2D | Patch] = [
        line("ego now", color="black", marker="o", markersize=7, linestyle=""),
    ]
    if explanation.answer.plan:
        entries += [
            line("its plan", color="black", linewidth=2.4, marker="o", markersize=4.2),
        ]
    if any(point.over for point in ego_path(explanation)):
        entries.append(line("still over the lane", color="black", marker="o", markerfacecolor="white", linestyle=""))
    if _changes_lane(explanation, in_view):
        entries.append(line("entering the lane", color="black", linewidth=2.4, linestyle=(0, (1.6, 1.0))))
    near = (
        "too near" if explanation.risk is None else f"risk above {percent(explanation.risk.level)},\nby one step alone"
    )
    entries += [
        Patch(facecolor=REACH_COLOR, edgecolor=REACH_EDGE, linewidth=0.5, label="safe, within reach"),
        Patch(facecolor=SAFE_COLOR, edgecolor="none", label="safe, out of reach"),
        Patch(facecolor=FORBIDDEN_COLOR, edgecolor=HATCH_COLOR, linewidth=0.5, hatch="/////", label=near),
    ]
    for index, vehicle in enumerate(explanation.vehicles):
        if vehicle.id not in in_view:
            continue
        color, marker = look_of(index)
        entries.append(line(vehicle.id, color=color, marker=marker, markersize=3.6, linewidth=1.1))
    if in_view:
        entries += [
            line("means, fainter\nif less likely", color="0.4", linewidth=1.1, marker="s", markersize=3.6, alpha=0.4)
        ]
    if in_view and explanation.risk is None:
        entries.append(line("margin either way", color="0.4", marker="|", markersize=9, linestyle=""))
    away = ", ".join(vehicle.id for vehicle in explanation.vehicles if vehicle.id not in in_view)
    if away:
        entries.append(line(fill(f"out of view: {away}", LEGEND_WIDTH), linestyle=""))
    return entries


def _changes_lane(explanation: Explanation, in_view: set[str]) -> bool:
    """Tell whether anything that is drawn changes its lane."""
    seen = [branch for vehicle in explanation.vehicles if vehicle.id in in_view for branch in vehicle.branches]
    laterals = [step.lateral for step in explanation.answer.plan]
    return any(laterals) or any(any(branch.laterals) for branch in seen)
